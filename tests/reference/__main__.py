"""Record reference results anew, and print what differs: `make reference [CASES="p45 plan"]`.

Only the cases whose names contain one of the words are recorded, or all; one is 'fault table'.
"""

import sys

from reference import fault_table
from reference.cases import CASES
from reference.recorded import FOLDER, as_text, compare, compute, from_text, recorded, write


def main(words: list[str]) -> None:
    FOLDER.mkdir(exist_ok=True)
    for name in CASES:
        if not words or any(word in name for word in words):
            _record(name)
    if not words or any(word in "fault table" for word in words):
        fault_table.record()


def _record(name: str) -> None:
    result, before = compute(name), recorded(name)
    if result is None:
        print(f"{name}: its data are not here (TRUENEWTON_REAL_DATA)", flush=True)
        return
    text = as_text(result)
    said = ["new"]
    if before:
        said = compare(from_text(before), from_text(text), CASES[name].tolerance)
    print("\n    ".join([f"{name}: {'differs' if said else 'as recorded'}", *said]), flush=True)
    if said:
        write(name, text)


main(sys.argv[1:])
