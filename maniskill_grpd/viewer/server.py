"""Servers that browsers connect to."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
from typing import TYPE_CHECKING

from maniskill_grpd.extras import import_extra

if TYPE_CHECKING:
    import viser

HOST = "127.0.0.1"
"""This machine alone."""
PORT = 8080
PORTS_TRIED = 100
"""How many ports are tried, the wanted one and those above it."""


def open_server(host: str = HOST, port: int = PORT) -> viser.ViserServer:
    """Start a server, on the next free port where the wanted one is in use; `address_of` says which.

    Args:
        host: Address to listen on; any but 127.0.0.1 lets other machines in.
        port: Wanted port, 1 to 65535.

    Raises:
        MissingExtraError: Without viser.
        ValueError: If the port is none, or the address is not one of this machine.
        OSError: If no port is free.
    """
    if not 1 <= port <= 65535:
        raise ValueError(f"port must be in [1, 65535], got {port}")
    viser = import_extra("viser", "viewer", "the viewer")
    free = _free_port(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # a greeting of its own
        server = viser.ViserServer(host=host, port=free, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


def address_of(server: viser.ViserServer) -> str:
    """Return where a browser on this machine finds a server."""
    host = server.get_host()
    return f"http://{'127.0.0.1' if host in ('0.0.0.0', '::') else host}:{server.get_port()}"


def _free_port(host: str, port: int) -> int:
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM) as probe:
            # As servers do: a port whose last connections have just ended is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
            except socket.gaierror as error:
                raise ValueError(f"host must be an address of this machine, got {host!r}: {error}") from None
            except OSError as error:
                if error.errno == errno.EADDRNOTAVAIL:
                    raise ValueError(f"host must be an address of this machine, got {host!r}") from None
                continue
            return candidate
    raise OSError(f"no port from {port} to {port + PORTS_TRIED - 1} is free on {host}")
