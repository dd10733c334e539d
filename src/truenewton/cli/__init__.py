"""The command line: one file per section of `truenewton --help`.

main       collects the commands; errors become one line and an exit code
options    options and arguments that several commands share
segments   a command for each segment in turn, if the data are of several
json_schema   the JSON Schema of --json
terminal   results in a terminal: lines, JSON, progress
take       plan, acquire, import
calibrate  info, calibrate, recalibrate, compare, track
use        report, figures, modes, export
simulate   demo, simulate, prove, mirrors
"""

from truenewton.cli.main import main

__all__ = ["main"]
