"""Record reference results anew, and print what differs: `make reference [CASES="p45 plan"]`.

Only the cases whose names contain one of the words are recorded, or all.
"""

import sys

from reference.cases import CASES, TOLERANCES
from reference.recorded import FOLDER, as_text, compare, compute, from_text, path_of


def main(words: list[str]) -> None:
    FOLDER.mkdir(exist_ok=True)
    names = [name for name in CASES if not words or any(word in name for word in words)]
    for name in names:
        result, path = compute(name), path_of(name)
        if result is None:
            print(f"{name}: its data are not here (TRUENEWTON_REAL_DATA)", flush=True)
            continue
        text = as_text(result)
        if not path.exists():
            said = ["new"]
        else:
            said = compare(
                from_text(path.read_text(encoding="utf-8")), from_text(text), TOLERANCES[name]
            )
        print("\n    ".join([f"{name}: {'differs' if said else 'as recorded'}", *said]), flush=True)
        if said:
            path.write_text(text, encoding="utf-8")


main(sys.argv[1:])
