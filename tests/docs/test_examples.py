"""Each file of examples/ does as its first lines say."""

import ast
import json
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from tests import live_bus, needs
from tests.buses import eventually
from tests.docs.pages import ROOT
from tests.docs.simulated_shell import start_script
from tests.simulated_bus import Bus
from tfbus import Buffer, Recording, TransformListener
from tfbus.buffer import trajectories
from tfbus.bus.presence import describe_nodes, list_nodes
from tfbus.messages import CompressedImage, Image, LaserScan, PointCloud
from tfbus.testing.programs import Program

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def start(bus: Bus, name: str, *arguments: str) -> Program:
    """An example as a process on the bus."""
    return start_script(bus, ROOT / "examples" / name, *arguments)


def run(bus: Bus, name: str, *arguments: str) -> list[str]:
    """What an example that ends by itself prints."""
    process = start(bus, name, *arguments)
    assert process.wait() == 0, process.err
    return process.out


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_says_what_it_shows_and_how_to_run_it(path: Path) -> None:
    """The docstring is a sentence, and the command that runs the file."""
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    assert text.splitlines()[0].endswith(".")
    assert f"python examples/{path.name}" in text


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_every_example_is_run_by_a_test(path: Path) -> None:
    """This file starts it by its name."""
    assert f'"{path.name}"' in Path(__file__).read_text()


def test_a_listener_prints_where_the_broadcaster_has_its_camera(bus: Bus) -> None:
    """listener.py follows broadcaster.py, and both end with Ctrl-C."""
    listener, broadcaster = start(bus, "listener.py"), start(bus, "broadcaster.py")
    listener.wait_for_line(r"camera in world: \(1\.00, 0\.00, 1\.50\) m, yaw ")
    assert listener.stop() == 0
    assert broadcaster.stop() == 0


def test_a_listener_says_why_there_is_no_answer(bus: Bus) -> None:
    """Without a broadcaster listener.py logs the reason, and goes on."""
    listener = start(bus, "listener.py")
    listener.wait_for_line("WARN.*'camera'|WARN.*'world'")
    assert listener.stop() == 0


def test_asyncio_waits_for_static_and_dynamic_frames(bus: Bus) -> None:
    """wait_asyncio.py ends when static_frames.py and broadcaster.py have sent."""
    sensors, mast = start(bus, "static_frames.py"), start(bus, "broadcaster.py")
    for process in (sensors, mast):
        process.wait_for_line("ready")  # it waits no longer than 10 s
    waiting = start(bus, "wait_asyncio.py")
    assert waiting.wait() == 0, waiting.err
    assert sorted(waiting.out) == [
        "camera in world: [1.  0.  1.5]",
        "lidar in base_link: [0.  0.  0.3]",
    ]
    for process in (sensors, mast):
        assert process.stop() == 0


def test_asyncio_ends_with_ctrl_c(bus: Bus) -> None:
    """wait_asyncio.py ends without a traceback while it waits."""
    watcher = bus.node("watcher")
    waiting = start(bus, "wait_asyncio.py")
    eventually(lambda: "/async_listener" in list_nodes(watcher.session))
    # Ctrl-C just before asyncio waits leaves it coroutines that never ran, of which it warns.
    eventually(lambda: describe_nodes(watcher.session, "/async_listener")[0].buffers)
    assert waiting.stop() == 0, waiting.err
    assert waiting.err == []


@pytest.mark.real
def test_frames_are_served_over_http(bus: live_bus.Bus) -> None:
    """http_service.py answers a transform, the reason why there is none, and a wrong request."""
    mast = bus.start_command([sys.executable, str(ROOT / "examples" / "broadcaster.py")])
    command = [sys.executable, str(ROOT / "examples" / "http_service.py"), "--param", "port=0"]
    service = bus.start_command(command)
    address = service.wait_for_line("http://127").removesuffix("/TARGET/SOURCE")

    def status(path: str) -> int:
        with suppress(HTTPError), urlopen(address + path) as answer:
            assert json.load(answer)["xyz"] == pytest.approx([1.0, 0.0, 1.5])
            return 200
        return 0

    eventually(lambda: status("/world/camera") == 200)
    for path, code, reason in (
        ("/world/none", 404, "there is no frame 'none'"),
        ("/world", 400, "ask for /TARGET/SOURCE"),
    ):
        with pytest.raises(HTTPError) as refused:
            urlopen(address + path)
        with refused.value as answer:
            assert answer.code == code
            assert reason in json.load(answer)["error"]
    for process in (service, mast):
        assert process.stop() == 0, process.err
    assert not [line for line in service.err if "Traceback" in line], service.err


def test_the_buffer_works_alone(bus: Bus) -> None:
    """buffer_alone.py interpolates, answers many stamps, refuses, and extrapolates."""
    at, track, refused, beyond = run(bus, "buffer_alone.py")
    assert at == "at 2.25 s: [2.45 0.   0.5 ]"
    assert track == "track: 1001 poses from [0.2 0.  0.5] to [10.2  0.   0.5]"
    assert refused.startswith("FutureExtrapolationException: ")
    assert beyond == "extrapolated: [10.3  0.   0.5]"


def cells_of(name: str) -> list[dict[str, Any]]:
    """The cells of a notebook."""
    cells: list[dict[str, Any]] = json.loads((ROOT / "examples" / name).read_text())["cells"]
    return cells


def run_cell(source: str, names: dict[str, Any]) -> tuple[str, Any]:
    """What a cell prints, and the value of its last line where that is an expression."""
    body = ast.parse(source).body
    last = body[-1]
    value = None
    with redirect_stdout(StringIO()) as printed:
        if isinstance(last, ast.Expr):
            exec(compile(ast.Module(body[:-1], []), "cell", "exec"), names)
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        else:
            exec(compile(ast.Module(body, []), "cell", "exec"), names)
    return printed.getvalue(), value


def test_a_notebook_says_what_it_shows_and_how_to_run_it() -> None:
    """Its first cell is a title, and has the command that opens it."""
    text = "".join(cells_of("buffer_notebook.ipynb")[0]["source"])
    assert text.startswith("# ")
    assert "jupyter lab examples/buffer_notebook.ipynb" in text


def test_the_cells_of_a_notebook_still_say_what_is_kept_in_it() -> None:
    """Run one after the other, each cell of buffer_notebook.ipynb has the outputs in the file."""
    names: dict[str, Any] = {}
    for cell in cells_of("buffer_notebook.ipynb"):
        if cell["cell_type"] != "code":
            continue
        printed, value = run_cell("".join(cell["source"]), names)
        (kept,) = cell["outputs"]
        if kept["output_type"] == "execute_result":
            assert repr(value) == "".join(kept["data"]["text/plain"])
            assert printed == ""
        else:  # what `show` draws in a notebook it prints elsewhere
            text = kept["text"] if "text" in kept else kept["data"]["text/plain"]
            assert printed.rstrip("\n") == "".join(text).rstrip("\n")


def test_a_camera_on_an_arm_sees_the_same_from_other_places(bus: Bus) -> None:
    """camera_on_arm.py shows the path, and a point ahead of the camera as the arm turns."""
    *_, first, middle, last = out = run(bus, "camera_on_arm.py")
    assert out[2] == "   └─ camera *  (static)"
    assert first == "at 0.0 s: [2.4 0.  0.7]"
    assert middle == "at 0.5 s: [1.697 1.697 0.7  ]"
    assert last == "at 1.0 s: [0.  2.4 0.7]"


def test_a_robot_measures_the_walls_of_its_room_as_it_drives(bus: Bus) -> None:
    """The clouds and scans of sensors.py are where the walls are."""
    sensors = start(bus, "sensors.py")
    watcher = bus.node("watcher")
    buffer = Buffer()
    TransformListener(buffer, watcher)
    walls: dict[type, float] = {}

    def on_points(message: Any, transform: Any) -> None:
        points = transform.transform.apply(message.xyz())
        walls[type(message)] = float(abs(abs(points[:, :2]).max(axis=1) - 5.0).max())

    for kind, topic in ((PointCloud, "points"), (LaserScan, "scan")):
        watcher.create_subscription(kind, topic, on_points, in_frame="room")
    eventually(lambda: len(walls) == 2)
    assert max(walls.values()) < 1e-3
    assert sensors.stop() == 0


def test_a_camera_on_an_arm_is_found(bus: Bus) -> None:
    """hand_eye.py finds the camera to a millimetre, and others look it up while it runs."""
    calibration = start(bus, "hand_eye.py")
    drawn = calibration.wait_for_line(r"of the URDF: .* degrees off").split()
    assert (drawn[3], drawn[6]) == ("7.8", "5.42")
    found = calibration.wait_for_line(r"^found: .* degrees off").split()
    assert float(found[1]) < 1.0 and float(found[4]) < 0.1
    calibration.wait_for_line("ready")
    echo = bus.run("echo", "hand", "camera_found", "--once")
    assert echo.returncode == 0, echo.stderr
    assert calibration.stop() == 0


def test_a_marker_is_found_in_the_world(bus: Bus) -> None:
    """marker_in_world.py finds its tag to a centimetre, and shows the path to it."""
    needs.module("cv2")
    *_, path, _, _, _, _, off = run(bus, "marker_in_world.py")
    assert path == "   └─ tag *  (1 sample)"
    words = off.split()
    assert float(words[2]) < 10.0 and float(words[5]) < 5.0


def test_a_scan_is_undistorted(bus: Bus) -> None:
    """undistort_scan.py finds the walls where they are, which raw points miss by 0.7 m."""
    raw, straight = run(bus, "undistort_scan.py")
    assert raw.startswith("raw: up to 0.736 m")
    assert straight == "undistorted: up to 0.000 m"


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "need"), [("undistort_scan.py", "numpy"), ("marker_in_world.py", "cv2")]
)
def test_an_example_shows_a_page(bus: live_bus.Bus, name: str, need: str) -> None:
    """With --view it serves a page, and prints its address."""
    needs.module("viser")
    needs.module(need)
    shown = bus.start_command([sys.executable, str(ROOT / "examples" / name), "--view"])
    url = shown.wait_for_line("^View: http://127").removeprefix("View: ")
    with urlopen(url) as answer:
        assert answer.status == 200
    shown.stop()


def test_a_service_is_called_and_a_parameter_set(bus: Bus) -> None:
    """service_and_parameter.py answers with as many digits as the parameter says."""
    ruler, mast = start(bus, "service_and_parameter.py"), start(bus, "broadcaster.py")
    ruler.wait_for_line("ready")
    request = ("call", "distance", "{target: world, source: camera}")
    # It answers that there is no frame until the mast has sent.
    eventually(lambda: bus.run(*request).stdout == '{"distance_m": 1.803}\n')
    eventually(lambda: bus.run("param", "set", "ruler", "digits", "1").returncode == 0)
    eventually(lambda: bus.run(*request).stdout == '{"distance_m": 1.8}\n')
    for process in (ruler, mast):
        assert process.stop() == 0


def test_a_fleet_is_seen_and_a_robot_that_goes_is_marked(bus: Bus) -> None:
    """fleet_listener.py prints each robot by its namespace."""
    robots = [
        bus.start("static", "map", "base_link", "--x", number, "--namespace", f"robot{number}")
        for number in ("3", "7")
    ]
    tower = start(bus, "fleet_listener.py")
    tower.wait_for_line(r"robot3: \(3\.0, 0\.0\) m$")
    tower.wait_for_line(r"robot7: \(7\.0, 0\.0\) m$")
    assert robots[1].stop() == 0
    tower.wait_for_line(r"robot7: \(7\.0, 0\.0\) m \(gone\)")
    assert tower.stop() == 0


def test_two_robots_see_each_other(bus: Bus) -> None:
    """two_robots.py prints where each is for the other, and others see both in one map."""
    robots = start(bus, "two_robots.py")
    robots.wait_for_line(r"robot1 sees robot2 at \(-?\d\.\d, -?\d\.\d\) m")
    robots.wait_for_line(r"robot2 sees robot1 at \(-?\d\.\d, -?\d\.\d\) m")
    pair = ("robot1/base_link", "robot2/base_link", "--fleet", "--shared", "map")
    echo = bus.run("echo", *pair, "--once")
    assert echo.returncode == 0, echo.stderr
    assert robots.stop() == 0, robots.err
    assert not [line for line in robots.err if "Traceback" in line]


@pytest.mark.real
def test_the_bodies_of_a_simulation_are_frames(bus: live_bus.Bus) -> None:
    """mujoco_world.py publishes those that move and those that do not, in one tree. The import of
    MuJoCo starts a process.
    """
    needs.module("mujoco")
    program = str(ROOT / "examples" / "mujoco_world.py")
    simulation = bus.start_command([sys.executable, program])
    simulation.wait_for_line("ready")
    echo = bus.run("echo", "world", "camera", "--once", "--format", "json")
    assert echo.returncode == 0, echo.stderr
    x, y, z = json.loads(echo.stdout)["xyz"]
    assert y == pytest.approx(0.2)
    assert (x * x + (z - 2.0) ** 2) ** 0.5 < 1.001
    assert simulation.stop() == 0, simulation.err


@pytest.mark.real
def test_a_simulated_robot_measures_its_room(bus: live_bus.Bus) -> None:
    """The clouds of mujoco_robot.py are within the walls as it drives, and its camera sends images
    of the size that its CameraInfo has, by rays where there is no OpenGL.
    """
    needs.module("mujoco")
    watcher, buffer = bus.node("watcher"), Buffer()
    TransformListener(buffer, watcher)
    farthest: list[float] = []
    images: list[Image] = []

    def on_points(message: Any, transform: Any) -> None:
        points = transform.transform.apply(message.xyz())
        farthest.append(float(abs(points[:, :2]).max()))

    watcher.create_subscription(PointCloud, "points", on_points, in_frame="world")
    watcher.create_subscription(Image, "camera/image", images.append)
    program = str(ROOT / "examples" / "mujoco_robot.py")
    robot = bus.start_command([sys.executable, program], env={"MUJOCO_GL": "disabled"})
    eventually(lambda: len(farthest) > 3 and images)
    # The walls' inner sides; they are seen from outside where the robot leaves the room.
    assert max(farthest) == pytest.approx(3.9, abs=0.02)
    assert (images[0].width, images[0].height) == (320, 240)
    assert robot.stop() == 0, robot.err
    assert not [line for line in robot.err if "Traceback" in line], robot.err


def test_a_lidar_file_is_published(bus: Bus) -> None:
    """lidar_file.py sends its points ten times a second."""
    clouds: list[PointCloud] = []
    bus.node("sink").create_subscription(PointCloud, "points", clouds.append)
    lidar = start(bus, "lidar_file.py")
    eventually(lambda: len(clouds) > 2)
    assert len(clouds[0]) == 360 and clouds[0].frame_id == "lidar"
    assert lidar.stop() == 0, lidar.err


def test_a_lidar_file_that_is_none_is_a_mistake(bus: Bus, tmp_path: Path) -> None:
    """lidar_file.py names a file that is not there, or has no points, in a sentence."""
    (tmp_path / "a.ply").write_text("no cloud")
    for name, said in (("b.npy", "cannot be read: No such file"), ("a.ply", "must begin with")):
        lidar = start(bus, "lidar_file.py", str(tmp_path / name))
        assert lidar.wait() == 2
        assert said in lidar.stderr and "Traceback" not in lidar.stderr


@pytest.mark.real
def test_a_film_is_published_as_a_webcam_is(bus: live_bus.Bus, tmp_path: Path) -> None:
    """webcam.py plays a file at its rate, seen in its frame, and says that it has ended."""
    needs.module("cv2")
    import cv2

    film = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(film, cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for grey in range(0, 250, 5):
        writer.write(np.full((48, 64, 3), grey, np.uint8))
    writer.release()
    images: list[CompressedImage] = []
    watcher = bus.node("watcher")
    watcher.create_subscription(CompressedImage, "camera/image/compressed", images.append)
    camera = bus.start_command([sys.executable, str(ROOT / "examples" / "webcam.py"), film])
    eventually(lambda: len(images) > 3)
    assert (images[0].format, images[0].frame_id) == ("jpeg", "camera")
    assert cv2.imdecode(np.frombuffer(bytes(images[0].data), np.uint8), 1).shape == (48, 64, 3)
    assert camera.wait() == 1
    assert "Error: camera " in camera.err[-1]


@pytest.mark.real
def test_a_webcam_that_is_not_there_is_said(bus: live_bus.Bus) -> None:
    """webcam.py ends with a sentence."""
    needs.module("cv2")
    program = str(ROOT / "examples" / "webcam.py")
    camera = bus.start_command([sys.executable, program, "87"])
    eventually(lambda: any("Error: there is no camera 87" in line for line in camera.err))


def test_an_imu_sends_a_sample_each_millisecond(bus: Bus) -> None:
    """imu_1khz.py says what it sends, and its samples are a millisecond apart."""
    imu = start(bus, "imu_1khz.py")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener")):
        eventually(
            lambda: "imu" in buffer.frames() and len(trajectories.samples(buffer, "imu")) > 500
        )
        steps_ns = np.diff(trajectories.samples(buffer, "imu").stamps_ns)
    assert steps_ns.min() == 1_000_000
    assert not (steps_ns % 1_000_000).any()
    imu.wait_for_line(
        r"\d+ samples/s in \d+ messages/s, \d+\.\d % of a core, \d+\.\d\d degrees off"
    )
    assert imu.stop() == 0, imu.err


@pytest.mark.real
def test_the_log_of_a_drone_is_recorded_and_played(bus: live_bus.Bus, tmp_path: Path) -> None:
    """drone_log.py turns GPS and angles into frames as robots have them, and plays them."""
    needs.module("mcap")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener")):
        program = str(ROOT / "examples" / "drone_log.py")
        player = bus.start_command([sys.executable, program], cwd=tmp_path)
        eventually(lambda: buffer.can_transform("map", "drone"))
        assert player.stop() == 0, player.err
    with Recording(tmp_path / "drone_example.mcap") as recording:
        way = recording.trajectory("map", "drone")
    # A quarter of the round to the right: from heading north to heading east.
    assert way.xyz[25] == pytest.approx([30.0, 30.0, 2.5], abs=0.01)
    assert way[25].transform.as_rpy(degrees=True) == pytest.approx((20.0, -2.0, 0.0), abs=0.01)
    assert way[0].transform.as_rpy(degrees=True)[2] == pytest.approx(90.0)


def test_simulated_time_drives_a_timer(bus: Bus) -> None:
    """simulated_time.py lets ten simulated seconds pass, in which a timer ticks four times."""
    seconds, ticks = run(bus, "simulated_time.py")
    assert seconds == "simulated seconds: 10.0"
    assert ticks == "ticks of the timer: [2.5, 5.0, 7.5, 10.0]"


@pytest.mark.real
def test_a_follower_is_tested_in_a_simulated_network(bus: Bus) -> None:
    """test_follower.py passes."""
    example = str(ROOT / "examples" / "test_follower.py")
    process = bus.start_command([sys.executable, example])
    assert process.wait() == 0, process.out
    assert "3 passed" in process.out[-1]


@pytest.mark.real
def test_metrics_of_a_bus_are_scraped(bus: live_bus.Bus) -> None:
    """metrics_exporter.py has the age, rate and delay of a frame, and that its publisher left."""
    needs.module("prometheus_client")
    mast = bus.start_command([sys.executable, str(ROOT / "examples" / "broadcaster.py")])
    program = str(ROOT / "examples" / "metrics_exporter.py")
    given = ("port=0", "fleet=true", "shared=map")
    options = [word for each in given for word in ("--param", each)]
    exporter = bus.start_command([sys.executable, program, *options])
    bus.start("static", "map", "base_link", "--namespace", "robot7")
    address = exporter.wait_for_line("http://127")

    def scraped() -> dict[str, float]:
        with urlopen(address) as answer:
            lines = answer.read().decode().splitlines()
        rows = (line.rpartition(" ") for line in lines if not line.startswith("#"))
        return {name: float(value) for name, _, value in rows}

    camera = '{frame="camera",publisher="mast"}'
    wanted = {f"tfbus_frame_{each}{camera}" for each in ("age_seconds", "delay_seconds")}

    def has_all(metrics: dict[str, float]) -> bool:
        return (
            metrics.get(f"tfbus_frame_rate_hertz{camera}", 0.0) > 1.0 and wanted <= metrics.keys()
        )

    metrics = eventually(lambda: found if has_all(found := scraped()) else None)
    assert (metrics["tfbus_conflicts"], metrics["tfbus_refused_total"]) == (0.0, 0.0)
    eventually(lambda: any('frame="robot7/base_link"' in each for each in scraped()))
    assert not any('frame="robot7/map"' in each for each in scraped())
    assert mast.stop() == 0
    eventually(lambda: scraped()[f"tfbus_frame_gone{camera}"] == 1.0)
    assert exporter.stop() == 0, exporter.err


@pytest.mark.real
def test_own_checks_run_in_a_simulated_network(bus: Bus) -> None:
    """test_own_check.py passes."""
    process = bus.start_command([sys.executable, str(ROOT / "examples" / "test_own_check.py")])
    assert process.wait() == 0, process.out
    assert "1 passed" in process.out[-1]
