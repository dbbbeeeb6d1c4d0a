"""The command `gui` says at once what it cannot serve."""

import socket
from typing import Any

import pytest


def test_what_is_no_source_is_no_page(wct: Any) -> None:
    code, _, err = wct("gui", "nowhere.png")
    assert code == 2
    assert "nowhere.png: no such file" in err


def test_it_needs_its_extra(wct: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lirs_validation.cli.commands.gui.find_spec", lambda _: None)
    code, _, err = wct("gui")
    assert code == 2
    assert "pip install '.[gui]'" in err


def test_an_address_that_is_taken_is_one_line(wct: Any) -> None:
    pytest.importorskip("viser")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, _, err = wct("gui", "--port", str(port))
    assert code == 2
    assert f"127.0.0.1:{port}: cannot be listened at" in err


def test_an_address_of_another_machine_is_one_line(wct: Any) -> None:
    pytest.importorskip("viser")
    code, _, err = wct("gui", "--host", "192.0.2.1", "--port", "0")
    assert code == 2
    assert "192.0.2.1:0: cannot be listened at" in err
