"""How many states of many worlds a second a viewer shows, and whether its memory grows.

python benchmarks/viewer.py [--soak SECONDS] [--json FILE]

Sixteen cloths of 100 nodes on ClothHanging-v1, a policy acting, as fast as it goes, beside a client that takes all messages in
another process, as a browser would; with --soak also two clients in real time for so many seconds, which leave and come back
every ten seconds. Frames per second of processor time are of the process of the viewer alone, all its threads.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import torch
from machine import describe_machine, report

from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.session import Session

NUM_WORLDS, NUM_WARM, NUM_FRAMES = 16, 20, 200
VISIT = 10.0
"""How long a client of the soak stays [s]."""
CLIENT = """
import sys
import time
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
with connect(sys.argv[1], subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as socket:
    end = time.monotonic() + float(sys.argv[2])
    try:
        while (rest := end - time.monotonic()) > 0.0:
            socket.recv(timeout=rest)
    except (TimeoutError, ConnectionClosed):
        pass
"""


def open_session(num_worlds: int) -> Session:
    """Return a session with a policy that acts."""
    options = ("resolution=100", "graph_nodes=25")
    checkpoint = Path("checkpoints/cloth_hanging.pt")
    return Session(PlayConfig(checkpoint=checkpoint, env_kwargs=options, num_envs=num_worlds, port=18700, sim_backend="cpu"))


def visit(session: Session, seconds: float) -> subprocess.Popen:
    """Let a client look on for some time, in a process of its own."""
    address = session.address.replace("http", "ws")
    return subprocess.Popen([sys.executable, "-c", CLIENT, address, str(seconds)], stderr=subprocess.DEVNULL)


def measure_frames(is_seen: bool) -> dict[str, Any]:
    """Return how many frames a second the viewer makes, or the environment and the policy alone."""
    with open_session(NUM_WORLDS) as session:
        player = session.player
        player.speed = 0.0
        if not is_seen:
            player.watchers.clear()
        client = visit(session, 600.0) if is_seen else None
        for _ in range(NUM_WARM):
            player.step()
        wall, busy = time.perf_counter(), time.process_time()
        for _ in range(NUM_FRAMES):
            player.step()
        busy, wall = time.process_time() - busy, time.perf_counter() - wall
        if client is not None:
            client.terminate()
            client.wait()
    return {
        "what": "shown to a client" if is_seen else "environment and policy alone",
        "num_worlds": NUM_WORLDS,
        "frames_per_s": NUM_FRAMES / wall,
        "frames_per_processor_s": NUM_FRAMES / busy,
    }


def soak(seconds: float) -> dict[str, Any]:
    """Return how much memory and how many threads a viewer has over time, beside two clients that come and go."""
    samples = []
    with open_session(4) as session:
        session.start()
        end, visits = time.monotonic() + seconds, []
        while time.monotonic() < end:
            visits = [visit(session, VISIT) for _ in range(2)]
            for client in visits:
                client.wait()
            samples.append((resident_mib(), num_threads()))
        is_alive = session.is_alive
    settled = samples[max(len(samples) // 5, 1) :]
    return {
        "seconds": seconds,
        "visits": 2 * len(samples),
        "MiB_at_first": settled[0][0],
        "MiB_at_last": settled[-1][0],
        "threads_at_first": settled[0][1],
        "threads_at_last": settled[-1][1],
        "is_alive": is_alive,
    }


def resident_mib() -> float:
    """Return the memory of this process [MiB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def num_threads() -> int:
    """Return how many threads it has."""
    return len(list(Path("/proc/self/task").iterdir()))


def main() -> None:
    """Parse the command line, measure and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--soak", type=float, help="also look at memory for so many seconds; 600 in docs/benchmarks")
    parser.add_argument("--json", type=Path, help="also write the results to this file")
    options = parser.parse_args()
    torch.set_num_threads(1)
    machine = describe_machine()
    rows = [measure_frames(is_seen) for is_seen in (False, True)]
    if options.soak:
        rows.append(soak(options.soak))
    report(rows, machine, options.json)


if __name__ == "__main__":
    main()
