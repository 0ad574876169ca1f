"""In a real browser: pages show worlds, mice pull nodes, gizmos lead grippers, buttons steer, replays play by themselves."""

import contextlib
import io
import shutil
import socket
import time
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from maniskill_grpd.playing.gizmos import SIZE
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.player import Player
from maniskill_grpd.playing.session import Session
from maniskill_grpd.tasks.pictures.world_parts import WorldParts
from maniskill_grpd.viewer.replay import Replay

webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")
exceptions = pytest.importorskip("selenium.common.exceptions", reason="needs selenium")
pytest.importorskip("viser", reason="the viewer needs viser")

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = ("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
PATIENCE = 240.0

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="needs chromium and chromedriver"),
]


@pytest.fixture(scope="module")
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, "--window-size=800,700"):
        options.add_argument(flag)
    options.page_load_strategy = "none"  # `open_page` waits until something is drawn
    driver = webdriver.Chrome(service=webdriver.ChromeService(DRIVER), options=options)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def session(browser):
    """Return a session whose page is open: loading one takes long where WebGL is software."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = {"env_id": "ClothFolding-v1", "env_kwargs": ("resolution=100",), "agent": "zero", "sim_backend": "cpu"}
    with Session(PlayConfig(port=port, **options)) as session:
        session.player.repeats, session.player.speed = False, 0.5  # slower, for browsers that draw without a GPU
        session.start()
        open_page(browser, session)
        yield session


@pytest.fixture
def start(session):
    """Return a function that lets somebody act from the start of an episode."""

    def begin(agent: str) -> None:
        def on_thread() -> bool:
            session.player.choose_agent(agent)
            session.player.is_playing = True
            session.player.reset(7)
            return True

        on_player(session, on_thread)

    yield begin
    begin("zero")


def wait_for(condition: Callable[[], object]) -> object:
    """Return what a condition says as soon as that is true."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
    return found


def on_player(session: Session, what: Callable[[], object]) -> object:
    """Return what a function returns on the thread of the player."""
    found = []
    session.player.ask(lambda: found.append(what()))
    wait_for(lambda: found)
    return found[0]


def open_page(browser, session: Session) -> None:
    """Open the page of a session, and wait until its picture shows something."""
    browser.get(session.address)
    wait_for(lambda: session.server.get_clients() and browser.find_elements("tag name", "canvas"))
    wait_for(lambda: picture(browser).std(axis=(0, 1)).max() > 4.0)


def picture(browser) -> np.ndarray:
    """Return the left part of what the browser shows, without the panel, (H, W, 3)."""
    shots = []

    def shoot() -> bool:
        with contextlib.suppress(exceptions.TimeoutException):  # the driver gives a slow page ten seconds
            shots.append(browser.get_screenshot_as_png())
        return bool(shots)

    wait_for(shoot)
    return np.asarray(Image.open(io.BytesIO(shots[0])).convert("RGB"), dtype=float)[200:, :460]


def pixel_of(browser, session: Session, point: np.ndarray) -> tuple[int, int]:
    """Return where a point (3,) of the scene is in the canvas, from its middle [pixels]."""
    camera = next(iter(session.server.get_clients().values())).camera
    eye, target = np.asarray(camera.position), np.asarray(camera.look_at)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    way = point - eye
    height = browser.find_element("tag name", "canvas").size["height"]
    scale = 0.5 * height / np.tan(camera.fov / 2.0) / (way @ ahead)
    return round(scale * float(way @ right)), round(-scale * float(way @ np.cross(right, ahead)))


def hold(browser, start: tuple[int, int], motion: tuple[int, int]) -> None:
    """Press the mouse somewhere on the canvas and move it, without letting go."""
    canvas = browser.find_element("tag name", "canvas")
    mouse = webdriver.ActionChains(browser, duration=50)
    mouse.move_to_element_with_offset(canvas, *start).pause(0.5).click_and_hold().pause(0.2)
    for _ in range(10):
        mouse.move_by_offset(motion[0] // 10, motion[1] // 10).pause(0.05)
    mouse.pause(0.3).perform()


def press(browser, label: str) -> None:
    """Press a button of the panel."""
    wait_for(lambda: [b for b in browser.find_elements("tag name", "button") if b.text == label])[0].click()


def test_the_page_shows_the_worlds_and_they_move(browser, session, start):
    start("zero")
    before = picture(browser)
    start("expert")
    wait_for(lambda: np.abs(picture(browser) - before).max() > 50.0)


def test_a_mouse_pulls_a_node_in_the_solver_and_lets_it_go(browser, session, start):
    start("zero")
    solver = session.player.base.solver
    middle = on_player(session, lambda: solver.positions[0].mean(dim=0).numpy())
    before = on_player(session, solver.positions[0].clone)
    hold(browser, pixel_of(browser, session, middle), (0, -80))
    wait_for(lambda: on_player(session, lambda: int(solver.tug_nodes[0])) >= 0)
    node = on_player(session, lambda: int(solver.tug_nodes[0]))
    assert np.linalg.norm(before[node].numpy() - middle) < 0.04  # that to which the mouse points
    wait_for(lambda: on_player(session, lambda: float(solver.positions[0, node, 2])) > float(before[node, 2]) + 0.03)
    assert on_player(session, lambda: float(solver.positions[0, node, 2])) < 1.0
    webdriver.ActionChains(browser).release().perform()
    wait_for(lambda: on_player(session, lambda: int(solver.tug_nodes[0])) == -1)
    wait_for(lambda: on_player(session, lambda: float(solver.positions[0, node, 2])) < 0.03)  # it falls


def test_a_gizmo_leads_its_gripper(browser, session, start):
    start("teleop")
    solver, agent = session.player.base.solver, session.player.agent
    before = on_player(session, solver.gripper_positions[0].clone)

    def pull_up() -> bool:
        """Take an arrow of the gizmo off its middle, along the axis that points up; a slow page may not show it yet."""
        hold(browser, pixel_of(browser, session, before[0].numpy() + [0.0, 0.0, 0.5 * SIZE]), (0, -60))
        webdriver.ActionChains(browser).release().perform()
        return on_player(session, lambda: float(agent.targets[0, 2])) > float(before[0, 2]) + 0.02

    wait_for(pull_up)
    wait_for(lambda: on_player(session, lambda: float(solver.gripper_positions[0, 0, 2])) > float(before[0, 2]) + 0.02)
    assert on_player(session, lambda: (agent.targets[1] - before[1]).abs().max()) < 1e-5


def test_buttons_pause_step_and_reset(browser, session, start):
    start("expert")
    press(browser, "Pause")
    wait_for(lambda: not session.player.is_playing)
    step = session.player.moment.step
    press(browser, "Step")
    wait_for(lambda: session.player.moment.step == step + 1)
    press(browser, "Reset")
    wait_for(lambda: session.player.moment.step == 0)
    press(browser, "Play")
    wait_for(lambda: session.player.moment.step > 2)


def test_a_closed_page_leaves_the_player_alive_and_lets_go_of_what_it_held(browser, session, start):
    start("zero")
    solver = session.player.base.solver
    middle = on_player(session, lambda: solver.positions[0].mean(dim=0).numpy())
    hold(browser, pixel_of(browser, session, middle), (0, -60))
    wait_for(lambda: on_player(session, lambda: int(solver.tug_nodes[0])) >= 0)
    browser.get("about:blank")
    wait_for(lambda: on_player(session, lambda: int(solver.tug_nodes[0])) == -1)
    wait_for(lambda: not session.server.get_clients())
    step = session.player.moment.step
    wait_for(lambda: session.player.moment.step > step + 2)


def test_a_replay_plays_from_the_file_system(browser, tmp_path):
    player = Player(PlayConfig(env_id="ClothFolding-v1", env_kwargs=("resolution=100",), sim_backend="cpu"))
    parts = WorldParts(player.base, [0])
    replay = Replay("a fold", 0.05, parts.towards_viewer)
    for _ in range(60):
        player.step()
        replay.add(parts.parts(), "a caption")
    player.close()
    browser.get(replay.write(tmp_path / "replay.html").as_uri())
    wait_for(lambda: browser.find_element("id", "caption").text == "a caption")
    wait_for(lambda: picture(browser).std() > 4.0)
    first = picture(browser)
    wait_for(lambda: np.abs(picture(browser) - first).max() > 50.0)
    assert not browser.find_element("id", "problem").text
