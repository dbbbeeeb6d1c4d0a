"""The page under load: broken uploads, and clients that disappear during a drive."""

import asyncio
import gc
import threading
import weakref
from collections.abc import Coroutine, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from lirs_wct.errors import WctError
from tests.lirs_validation.gui.pages import wait_for

pytestmark = pytest.mark.slow
CLIENTS, FILES = 8, 5
DRIVING = 2
"""Clients that disappear during a drive."""
VIEW: dict[str, Any] = {
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (5.0, 5.0, 5.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
SIZE = 300_000
"""Bytes of a broken file."""


@pytest.fixture
def errors(monkeypatch: pytest.MonkeyPatch) -> list[Exception]:
    """Errors that the pages show."""
    from lirs_validation.gui.page import Guard

    shown: list[Exception] = []
    show = Guard.show

    def note(guard: Guard, error: Exception) -> None:
        shown.append(error)
        show(guard, error)

    monkeypatch.setattr(Guard, "show", note)
    return shown


class Client:
    """A browser's end of the connection, without a browser."""

    def __init__(self, server: Any) -> None:
        self._server = server

    async def connect(self) -> None:
        import viser
        from websockets.asyncio.client import connect

        self._socket = await connect(
            self._server.address.replace("http", "ws"),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            max_size=None,
            compression=None,
        )
        self._reading = asyncio.create_task(self._read())
        import msgspec
        from viser import _messages

        view = _messages.ViewerCameraMessage(**VIEW)  # the server waits for it
        await self._socket.send(msgspec.msgpack.encode(view.as_serializable_dict()))

    async def _read(self) -> None:
        with suppress(ConnectionClosed):
            async for _ in self._socket:
                pass

    async def vanish(self) -> None:
        """Cut the connection without a farewell."""
        self._socket.transport.abort()
        await asyncio.wait([self._reading])


def broken_files(picture: Path, rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    """Yield damaged files of five kinds."""
    noise = rng.bytes(SIZE)
    yield "hill.png", picture.read_bytes()[:200] + noise
    yield "rock.stl", bytes(80) + np.uint32(9_000_000).tobytes() + noise
    yield "drive.mcap", b"\x89MCAP0\r\n" + noise
    yield (
        "cloud.pcd",
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nDATA binary\n" + noise,
    )
    yield "log.clf", noise


def open_file(page: Any, name: str, content: bytes) -> None:
    """Open a file as the upload button does."""
    page.guard(lambda _: page.world.open(name, content))(None)


async def until(condition: Any, seconds: float = 200.0) -> None:
    await asyncio.to_thread(wait_for, condition, seconds)


async def a_round(
    server: Any, picture: Path, errors: list[Exception], rng: np.random.Generator
) -> tuple[list[weakref.ref[Any]], list[Path]]:
    """Let each client send five broken files; all disappear, some during a drive.

    Return their pages, which nothing should hold any more, and their folders of uploads.
    """
    errors.clear()
    clients = [Client(server) for _ in range(CLIENTS)]
    await asyncio.gather(*(client.connect() for client in clients))
    await until(lambda: len(server.pages) == CLIENTS)
    pages = sorted(server.pages, key=lambda page: page.client.client_id)
    await until(lambda: all(page.world.shown is not None for page in pages))
    for kind, files in enumerate(zip(*(broken_files(picture, rng) for _ in clients), strict=True), 1):
        for page, file in zip(pages, files, strict=True):
            open_file(page, *file)
        await until(lambda so_far=CLIENTS * kind: len(errors) >= so_far)
    for page in pages[:DRIVING]:
        page.drive.start(((-7.0, -13.0), (7.0, -11.0)))
    await until(lambda: all(page.drive.playback is not None for page in pages[:DRIVING]))
    await asyncio.gather(*(client.vanish() for client in clients))
    await until(lambda: not server.pages)
    await until(lambda: not page_threads())
    return [weakref.ref(page) for page in pages], [page.uploads.folder for page in pages]


def page_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("page ")]


def children() -> set[int]:
    tasks = Path("/proc/self/task").glob("*/children")
    return {int(pid) for path in tasks for pid in path.read_text().split()}


def run_apart(work: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine in a thread: a browser of earlier tests may keep this thread's loop running."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, work).result()


def alive(pages: Iterable[weakref.ref[Any]]) -> int:
    gc.collect()
    return sum(page() is not None for page in pages)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")
def test_broken_uploads_and_lost_clients_leave_nothing(
    server: Any, picture: Path, errors: list[Exception]
) -> None:
    rng, before, every = np.random.default_rng(1), children(), list[weakref.ref[Any]]()
    for _ in range(2):
        pages, folders = run_apart(a_round(server, picture, errors, rng))
        assert len(errors) == CLIENTS * FILES
        for error in errors:
            assert isinstance(error, WctError), repr(error)
            assert "\n" not in str(error)
        errors.clear()  # their tracebacks hold the pages
        wait_for(lambda: children() <= before, 20)
        every += pages
        # The server's loop may hold the page that it served last.
        wait_for(lambda so_far=tuple(every): alive(so_far) <= 1, 20)
        assert not any(folder.exists() for folder in folders)
    run_apart(a_healthy_client(server, picture, errors))


async def a_healthy_client(server: Any, picture: Path, errors: list[Exception]) -> None:
    client = Client(server)
    await client.connect()
    await until(lambda: len(server.pages) == 1)
    (page,) = server.pages
    await until(lambda: page.world.shown is not None)
    open_file(page, picture.name, picture.read_bytes())
    await until(lambda: page.world.shown.world.name == "hill")
    assert errors == []
    await client.vanish()
