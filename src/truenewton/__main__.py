"""`python -m truenewton` is `truenewton`."""

from truenewton.cli import main

if __name__ == "__main__":
    main()
