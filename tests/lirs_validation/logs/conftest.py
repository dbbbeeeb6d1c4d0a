"""Logs are mapped without the mappers' warm-up, which changes times only."""

import pytest


@pytest.fixture(autouse=True)
def _without_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lirs_validation.logs.map_log.warm_up", lambda name, **config: None)
