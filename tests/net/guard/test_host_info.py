"""What this machine is called and where it is reached."""

from __future__ import annotations

import ipaddress
import socket
import struct

import pytest

from glsplat.net.guard import host_info
from glsplat.net.guard.host_info import machine_addresses, reachable_at

IF_INET6 = """\
00000000000000000000000000000001 01 80 10 80       lo
fe80000000000000022a3bfffe000001 02 40 20 80     eth0
fd00000000000000000000000000000a 02 40 00 82     eth0
20010db8000000000000000000000001 02 40 00 01     eth0
20010db8000000000000000000000002 02 40 00 20     eth0
20010db8000000000000000000000003 02 40 00 80     eth0
"""


def test_addresses_can_be_bound_to():
    for address in machine_addresses():
        assert not ipaddress.ip_address(address).is_loopback
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as own:
            own.bind((address, 0))  # fails for those of other machines


def test_each_interface_has_its_address(monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    addresses = {b"lo": "127.0.0.1", b"eth0": "192.0.2.9", b"eth1": "198.51.100.254"}

    def ioctl(of, code, name):
        address = socket.inet_aton(addresses[name[:16].rstrip(b"\0")])
        return name[:16] + struct.pack("<HH", socket.AF_INET, 0) + address + bytes(232)

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    monkeypatch.setattr(host_info.socket, "if_nameindex", lambda: [(1, "lo"), (2, "eth0"), (3, "eth1")])
    assert host_info._interfaces() == ["192.0.2.9", "198.51.100.254"]


def test_temporary_addresses_are_left_out(tmp_path, monkeypatch):
    (tmp_path / "if_inet6").write_text(IF_INET6)
    monkeypatch.setattr(host_info, "Path", lambda name: tmp_path / "if_inet6")
    assert host_info._lasting() == ["fd00::a", "2001:db8::3"]


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("0.0.0.0", ("192.0.2.7", "10.0.0.1")),
        ("::", ("192.0.2.7", "10.0.0.1", "fd00::a")),
        ("192.0.2.7", ("192.0.2.7",)),
        ("lab.example", ("lab.example",)),
    ],
)
def test_where_a_server_is_reached(monkeypatch, host, expected):
    monkeypatch.setattr(host_info, "_outward", lambda family: "192.0.2.7")
    monkeypatch.setattr(host_info, "_interfaces", lambda: ["10.0.0.1", "192.0.2.7"])
    monkeypatch.setattr(host_info, "_lasting", lambda: ["fd00::a"])
    assert reachable_at(host) == expected


def test_without_a_network_there_is_none(monkeypatch):
    class Unreachable(socket.socket):
        def connect(self, address):
            raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(host_info.socket, "socket", Unreachable)
    monkeypatch.setattr(host_info, "_interfaces", list)
    monkeypatch.setattr(host_info, "_lasting", list)
    assert machine_addresses() == ()
