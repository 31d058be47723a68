"""bench/link.py counts right: the link it makes, and what it finds in the way."""

from __future__ import annotations

import importlib
import socket
import subprocess
import sys

import pytest

from tests.conftest import ROOT


@pytest.fixture
def bench(monkeypatch):
    """Modules of bench/ by name, which import each other as scripts do."""
    monkeypatch.syspath_prepend(str(ROOT / "bench"))
    return importlib.import_module


def test_a_link_has_a_rate_a_delay_and_a_queue(bench):
    """Packets go one after another, arrive a delay later, and are dropped beyond the queue."""
    network = bench("network")
    way = network._Way(rate=1e6, delay=0.05)
    packet = bytes(1250)  # 10 ms
    assert [way.due(packet, 5.0) for _ in range(3)] == pytest.approx([5.06, 5.07, 5.08])
    assert way.due(packet, 9.0) == pytest.approx(9.06)  # nothing was saved up meanwhile
    sent = [way.due(packet, 9.0) for _ in range(200)]
    assert sum(at is not None for at in sent) == pytest.approx(network.QUEUE * 1500 / 1250, abs=1)
    assert way.dropped == sent.count(None) > 0


def test_what_is_in_transit(bench):
    """What was taken by then and had not come by then."""
    transit = bench("link").transit
    taken = [[1.0, 100], [2.0, 300], [4.0, 350]]
    got = [[1.5, 100], [3.0, 300]]
    assert transit(taken, got, [0.5, 1.2, 1.7, 2.5, 3.5, 9.0]) == [0, 100, 0, 200, 0, 50]


def test_without_root_it_says_so(bench, monkeypatch, capsys):
    """One line, and an exit code."""
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert bench("link").main(["--presenters", "halfblock"]) == 1
    assert capsys.readouterr().err == "no link: network namespaces need root\n"


def test_the_terminal_answers_in_order(bench):
    """Questions, marks and reports in any pieces; a picture counts when its report is reached."""
    link = bench("link")
    stream = (
        b"\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\\x1b[>q\x1b[c"
        b"\x1b]7771;3;2;1000\x07PICTURE\x1b[5n\x1b]7771;4;0;0\x07"
    )
    for piece in (1, 7, len(stream)):
        ours, theirs = socket.socketpair()
        terminal = link.Terminal(theirs, kitty=True)
        for at in range(0, len(stream), piece):
            ours.sendall(stream[at : at + piece])
            terminal._read()
        want = b"\x1b_Gi=31;OK\x1b\\\x1bP>|bench(1.0)\x1b\\\x1b[?62;4;22c\x1b[0n"
        assert ours.recv(1000) == want
        shown = [(p.keys, p.level, p.payload) for p in terminal.pictures]
        assert shown == [(3, 2, 1000)]
        assert terminal.shows(3)
        assert not terminal.shows(4)
        assert terminal.total == len(stream)
        ours.close()
        theirs.close()


def test_bytes_pass_between_the_namespaces(bench):
    """In both directions; afterwards no namespace is left."""
    network = bench("network")
    code = (
        "import socket\n"
        f"with socket.create_server(('{network.ADDRESSES[0]}', 7001)) as server:\n"
        "    print('up', flush=True)\n"
        "    connection = server.accept()[0]\n"
        "    connection.sendall(connection.recv(9) * 5000)\n"
    )
    asks = (
        "import socket\n"
        f"with socket.create_connection(('{network.ADDRESSES[0]}', 7001), 20) as c:\n"
        "    c.sendall(b'123456789')\n"
        "    print(sum(map(len, iter(lambda: c.recv(4096), b''))))\n"
    )
    try:
        with network.network(8e6, 0.01) as ends:
            command = ends.inside(ends.sender, [sys.executable, "-c", code])
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
                assert server.stdout.readline() == "up\n"
                command = ends.inside(ends.receiver, [sys.executable, "-c", asks])
                got = subprocess.run(command, capture_output=True, text=True, check=True)
            assert got.stdout == "45000\n"
    except network.NoNetworkError as error:
        pytest.skip(f"no network namespaces here: {error}")
    left = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True)
    assert ends.sender not in left.stdout
    assert ends.receiver not in left.stdout
