"""`python -m lirs_validation` is `lirs-wct`."""

from lirs_validation.cli.app import main

if __name__ == "__main__":
    main()
