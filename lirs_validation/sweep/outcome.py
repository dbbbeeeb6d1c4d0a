"""How an experiment ended: little enough to send and to keep for thousands of them."""

from __future__ import annotations

import traceback
from dataclasses import dataclass

from lirs_validation.interrupts import is_interrupt
from lirs_validation.record.run_record import SUCCEEDED, Status
from lirs_wct.errors import MapperError, OutputError, WctError


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How an experiment ended.

    Attributes:
        experiment: its name.
        status: that of its record.
        reason: one line.
        trace: where it failed, several lines; empty where it did not.
        bad_input: whether something that the user gave cannot be used.
        written: whether its folder is written.
        unwritable: whether its results could not be written: it is worth running again.
    """

    experiment: str
    status: Status
    reason: str = ""
    trace: str = ""
    bad_input: bool = False
    written: bool = False
    unwritable: bool = False

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.status in SUCCEEDED


def outcome_of(error: BaseException, experiment: str) -> Outcome:
    """Return the outcome of an experiment that raised.

    Raises:
        KeyboardInterrupt: the error is a Ctrl-C that a compiled kernel wrapped.
    """
    if is_interrupt(error):
        raise KeyboardInterrupt from error
    ours = isinstance(error, WctError)
    message = str(error) if ours else ": ".join(filter(None, (type(error).__name__, str(error))))
    return Outcome(
        experiment=experiment,
        status="error",
        reason=" ".join(message.split()),
        trace="".join(traceback.format_exception(error)),
        bad_input=ours and not isinstance(error, (MapperError, OutputError)),
        unwritable=isinstance(error, OutputError),
    )
