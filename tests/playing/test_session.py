"""Sessions: clients that come, go and send rubbish, recordings by hand, how a session ends."""

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import gymnasium as gym
import pytest
import torch

from maniskill_grpd.imitation.demonstrations import load_demonstrations
from maniskill_grpd.playing import show_notebook
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.session import Session
from maniskill_grpd.trajectory.recording import read_recording
from maniskill_grpd.trajectory.replay import replay

viser = pytest.importorskip("viser", reason="the viewer needs viser")
client = pytest.importorskip("websockets.sync.client")

PATIENCE = 60.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def open_session(**options) -> Session:
    return Session(PlayConfig(**{"env_id": "RopeShaping-v1", "sim_backend": "cpu", "port": free_port(), **options}))


def connect(session: Session) -> client.ClientConnection:
    address = session.address.replace("http", "ws")
    return client.connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, max_queue=None)


def num_connected(session: Session) -> int:
    """Return how many sockets are open; viser counts clients from when they have told where their camera is."""
    return len(session.server._websock_server._client_state_from_id)


def wait_for(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


def test_two_clients_come_go_and_send_rubbish_and_the_player_goes_on():
    with open_session() as session:
        session.start()
        with connect(session) as first, connect(session) as second:
            assert first.recv(timeout=PATIENCE)
            assert second.recv(timeout=PATIENCE)
            wait_for(lambda: num_connected(session) == 2)
            first.send(b"\xff\x00 rubbish")
            first.send("words")
            with socket.create_connection(("127.0.0.1", session.server.get_port())) as plain:
                plain.sendall(b"\x00\x01 neither HTTP nor anything else\r\n\r\n")
            assert second.recv(timeout=PATIENCE)
        wait_for(lambda: num_connected(session) == 0)
        step = session.player.moment.step
        wait_for(lambda: session.player.moment.step != step)
        with connect(session) as third:
            assert third.recv(timeout=PATIENCE)
        assert session.is_alive


def test_a_port_in_use_is_said():
    port = free_port()
    with open_session(port=port), open_session(port=port) as second:
        taken = second.server.get_port()
        assert second.greeting().startswith(f"port {port} is in use, {taken} is taken instead")
        assert f"127.0.0.1:{taken}" in second.greeting()


def test_what_is_recorded_misses_no_state(tmp_path):
    path = tmp_path / "out.html"
    with open_session(record=path) as session:
        for _ in range(5):
            session.player.step()
        assert len(session.view.replay) == 6
    assert path.stat().st_size > 10_000
    with pytest.raises(FileExistsError, match=r"out\.html exists"):
        open_session(record=path)


@pytest.mark.parametrize("options", [("num_grippers=2",), ("num_grippers=2", 'grasp="free"')])
def test_an_episode_led_by_hand_is_replayed_and_can_be_cloned(tmp_path, options):
    with open_session(agent="teleop", env_kwargs=options, demonstrations=tmp_path) as session:
        player = session.player
        player.start_recording()
        player.agent.targets += torch.tensor([0.0, 0.05, 0.05])
        for _ in range(6):
            player.step()
        places = player.base.solver.positions[0].clone()
        player.keep_episode()
        player.step()  # an episode that is not kept
        player.stop_recording()
        player.step()
    path = tmp_path / "teleop_0.h5"
    (episode,) = read_recording(path).episodes
    assert len(episode.actions) == 6
    assert episode.states is not None
    assert replay(["--traj-path", str(path), "--save-traj", "--allow-failure", "-o", "graph"]) == 1
    (again,) = read_recording(next(tmp_path.glob("teleop_0.graph.*.h5"))).episodes
    torch.testing.assert_close(torch.as_tensor(_positions(again.state(6))), places.flatten())
    env = gym.make("RopeShaping-v1", obs_mode="graph", num_grippers=2, sim_backend="cpu")
    demonstrations = load_demonstrations(path, env.unwrapped.graph_schema, has_grippers=len(options) == 2)
    assert demonstrations.actions.shape == (6, 2, 4 if len(options) == 2 else 3)
    assert demonstrations.actions[0, 0, 2] > 0.5
    env.close()


def _positions(state: dict) -> object:
    """Return the positions of the nodes in a state."""
    found = {key: value for key, value in _leaves(state).items() if key.endswith("/positions")}
    (positions,) = found.values()
    return positions


def _leaves(tree: dict, path: str = "") -> dict:
    parts = [_leaves(v, f"{path}/{k}") if isinstance(v, dict) else {f"{path}/{k}": v} for k, v in tree.items()]
    return {key: value for part in parts for key, value in part.items()}


def test_mice_are_told_that_nothing_is_pulled_while_episodes_are_recorded(tmp_path):
    with open_session(agent="teleop", demonstrations=tmp_path) as session:
        session.player.start_recording()
        session.view.scene._drags.put(_drag(session))
        session.player.step()
        assert (session.player.base.solver.tug_nodes == -1).all()
        assert any("dragging is off" in message for message in session.panel._messages)


def test_mice_pull_while_the_agent_acts_and_a_reset_lets_go():
    with open_session(agent="expert") as session:
        session.view.scene._drags.put(_drag(session))
        session.player.step()
        assert (session.player.base.solver.tug_nodes >= 0).all()
        session.player.reset()
        assert (session.player.base.solver.tug_nodes == -1).all()


def _drag(session: Session) -> object:
    from maniskill_grpd.viewer.drag import Drag

    place = session.player.base.solver.positions[0, 3].numpy()
    return Drag(0, "start", place, place + [0.0, 0.0, 0.1])


def test_memory_and_threads_do_not_grow_with_clients_that_come_and_go():
    """A short form of `benchmarks/viewer.py --soak`: message queues of clients that left must be gone."""
    with open_session(num_envs=2) as session:
        session.player.speed = 0.0
        session.start()
        counts = []
        for _ in range(6):
            with connect(session) as one, connect(session) as other:
                assert one.recv(timeout=PATIENCE)
                assert other.recv(timeout=PATIENCE)
            wait_for(lambda: num_connected(session) == 0)
            step = session.player.moment.step
            wait_for(lambda step=step: session.player.moment.step != step)
            counts.append((threading.active_count(), len(session.server._websock_server._broadcast_buffer.message_from_id)))
        assert counts[-1][0] <= counts[2][0] + 1
        assert counts[-1][1] <= counts[2][1] + 20
        assert session.is_alive


def test_a_notebook_shows_the_page_and_gives_the_environment_back():
    env = gym.make("RopeShaping-v1", num_envs=2, obs_mode="graph", sim_backend="cpu")
    viewer = show_notebook(env, "expert", port=free_port())
    assert f'src="{viewer.address}"' in viewer._repr_html_()
    wait_for(lambda: viewer.player.moment.step > 3)
    with connect(viewer) as client_of_it:
        assert client_of_it.recv(timeout=PATIENCE)
    viewer.close()
    assert not viewer.is_alive
    env.reset(seed=[1, 2])
    env.close()


def test_ctrl_c_ends_the_program(tmp_path):
    command = [sys.executable, "-m", "maniskill_grpd", "play", "--env_id", "RopeShaping-v1", "--port", str(free_port())]
    path = tmp_path / "out.html"
    program = subprocess.Popen([*command, "--record", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert program.stdout.readline().startswith("open http://127.0.0.1:")
    time.sleep(1.0)
    program.send_signal(signal.SIGINT)
    out, errors = program.communicate(timeout=PATIENCE)
    assert program.returncode == 0, errors
    assert "ended" in out
    assert path.exists()
