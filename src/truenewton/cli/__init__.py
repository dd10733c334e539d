"""The command line: one file a command, which parses, calls and prints.

main         gathers the commands; errors become one line and an exit code
options      options and arguments that several commands share
terminal     how results look in a terminal: JSON, progress
import_      a stiffness file from other people's files
export       a supervisor's files with alpha in
calibrate    from cycle files or a stiffness file to alpha
info         what a file holds, and whether it is sound
report       what a campaign gave, on one page
figures      the paper's figures 2, 5, 6 and their kin
plan         what a campaign will give, before anyone touches glass
acquire      run a plan on a bench; again, to go on
track        how alpha varies with temperature and time
recalibrate  a short run after a part was replaced
modes        stiffness modes, and how many a power or a force allows
mirrors      the known mirrors and their sources
simulate     a campaign on the simulated bench
serve        the simulated bench behind a real OPC UA server
prove        the paper's proof code
demo         simulate, calibrate, compare with the truth, report
"""

from truenewton.cli.main import main

__all__ = ["main"]
