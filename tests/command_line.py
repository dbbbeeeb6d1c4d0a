"""The command line, called in this process."""

import pytest

from lirs_validation.cli import app as cli


def run_command(*arguments: str) -> int:
    """Run `lirs-wct ARGUMENTS` and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["lirs-wct", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    return int(ended.value.code or 0)
