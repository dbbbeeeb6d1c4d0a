"""Validation runs (world x robot x mapper x seed), their records, reports and command line."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_validation.analysis.results import read_results
    from lirs_validation.config import RunConfig
    from lirs_validation.experiment.run import Run, validate
    from lirs_validation.gui import EmbeddedPage, show
    from lirs_validation.logs.map_log import MappedLog, map_log, resolve_source
    from lirs_validation.record.run_record import RunRecord, read_record
    from lirs_validation.report.run_report import report_of

__all__ = [
    "EmbeddedPage",
    "MappedLog",
    "Run",
    "RunConfig",
    "RunRecord",
    "map_log",
    "read_record",
    "read_results",
    "report_of",
    "resolve_source",
    "show",
    "validate",
]

_NAMES = {
    "analysis.results": "read_results",
    "config": "RunConfig",
    "experiment.run": "Run validate",
    "gui": "EmbeddedPage show",
    "logs.map_log": "MappedLog map_log resolve_source",
    "record.run_record": "RunRecord read_record",
    "report.run_report": "report_of",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
