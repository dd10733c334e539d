"""`python -m truenewton` is `truenewton`."""

from __future__ import annotations

from truenewton.cli import main

if __name__ == "__main__":
    main()
