"""Uploads that are too large are refused before they fill the memory.

viser gathers the parts of a file in memory and calls back when all are there. It has no limit of its own, so
this file alone reaches into its private parts (viser 1.1).
"""

from __future__ import annotations

from collections.abc import Callable

import viser
from viser import _messages

from lirs_wct.errors import WctError


def limit_uploads(
    client: viser.ClientHandle, check: Callable[[str, int], None], refused: Callable[[Exception], None]
) -> None:
    """Refuse the files of a page for which a check raises.

    Args:
        client: the page.
        check: called with name and bytes as announced, and again with what has come; raises WctError.
        refused: called with that error.
    """
    gui = client.gui
    connection = client._websock_connection

    def drop(transfer: str, error: WctError) -> None:
        gui._current_file_upload_states.pop(transfer, None)
        refused(error)

    def announced(_: int, message: _messages.FileTransferStartUpload) -> None:
        if message.transfer_uuid in gui._current_file_upload_states:
            try:
                check(message.filename, message.size_bytes)
            except WctError as error:
                drop(message.transfer_uuid, error)

    def arrived(_: int, message: _messages.FileTransferPart) -> None:
        state = gui._current_file_upload_states.get(message.transfer_uuid)
        if state is not None and state["transferred_bytes"] > state["total_bytes"]:
            try:
                check(state["filename"], state["transferred_bytes"])
            except WctError as error:
                drop(message.transfer_uuid, error)

    connection.register_handler(_messages.FileTransferStartUpload, announced)
    connection.register_handler(_messages.FileTransferPart, arrived)
