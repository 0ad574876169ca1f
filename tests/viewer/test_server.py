"""Servers listen on this machine alone, on a free port."""

import socket

import pytest

pytest.importorskip("viser", reason="the viewer needs viser")

from maniskill_grpd.viewer.server import address_of, open_server


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_a_port_in_use_is_passed_over():
    port = free_port()
    first = open_server(port=port)
    second = open_server(port=port)
    try:
        assert first.get_port() == port
        assert second.get_port() > port
        assert address_of(second) == f"http://127.0.0.1:{second.get_port()}"
    finally:
        first.stop()
        second.stop()


def test_other_machines_are_not_let_in():
    """Another address of this same machine, which a server on all addresses would answer."""
    server = open_server(port=free_port())
    try:
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(("127.0.0.2", server.get_port()), timeout=2.0)
        socket.create_connection(("127.0.0.1", server.get_port()), timeout=2.0).close()
    finally:
        server.stop()


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(ValueError, match=r"port must be in \[1, 65535\]"):
        open_server(port=port)


@pytest.mark.parametrize("host", ["203.0.113.7", "no.such.host.invalid"])
def test_an_address_of_another_machine_is_refused(host):
    with pytest.raises(ValueError, match="address of this machine"):
        open_server(host=host, port=free_port())
