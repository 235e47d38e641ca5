"""The view in the browser: logs with a slider, a file that plays by itself, or a running session."""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, redirect_stdout
from io import StringIO
from pathlib import Path

import viser

from imolo.campaigns.appearance import Appearance, appearances
from imolo.config.loading import known_body
from imolo.contracts.robot import Body
from imolo.errors import BackendNotFoundError, ConfigError, ResultsError
from imolo.machine.files import write_whole
from imolo.messaging.bus import Bus
from imolo.view.overlay import legend, with_overlay
from imolo.view.scene import SessionScene, prepare_scene, show_all
from imolo.view.sessions import LiveSession, RecordedSession

HOST = "127.0.0.1"
PICTURES = 60.0  # [Hz] of the browser
MOST_PICTURES = 100_000  # in one file


def describe(robot: str) -> Body:
    """Return what a robot looks like.

    Raises:
        BackendNotFoundError: It is not installed.
    """
    found = known_body(robot)
    if found is None:
        raise BackendNotFoundError(f"robot {robot!r} is not installed; `imolo robots` lists those that are")
    return found


def _open(sessions: Sequence[RecordedSession], port: int) -> tuple[viser.ViserServer, list[SessionScene]]:
    robots = sorted({session.robot for session in sessions})
    if len(robots) != 1:
        raise ConfigError(f"the logs show different robots: {', '.join(robots)}; view them one by one")
    description = describe(robots[0])
    server = _server(port)
    prepare_scene(server, description)
    colors = [None if look is None else look.color for look in _looks(sessions)]
    return server, [SessionScene(server, description, number, color) for number, color in enumerate(colors)]


def _looks(sessions: Sequence[RecordedSession]) -> Sequence[Appearance | None]:
    if len(sessions) == 1:
        return [None]
    return appearances([session.backend for session in sessions])


def _server(port: int) -> viser.ViserServer:
    with _silence():
        server = viser.ViserServer(host=HOST, port=port, label="imolo", verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


def _stop(server: viser.ViserServer) -> None:
    with _silence():
        server.stop()


def _silence() -> AbstractContextManager[object]:
    # viser prints its address and its end, whether told to be verbose or not.
    return redirect_stdout(StringIO())


def write_html(sessions: Sequence[RecordedSession], path: Path, speed: float) -> None:
    """Write one file that shows the sessions without a server or a network.

    Args:
        sessions: What to show.
        path: File to write.
        speed: How fast it plays; below 1 for slow motion.

    Raises:
        ConfigError: It would hold more pictures than a browser plays.
        ResultsError: The file cannot be written.
    """
    if len(_pictures(sessions, speed)) > MOST_PICTURES:
        seconds = max(session.duration for session in sessions)
        raise ConfigError(
            f"{seconds:.0f} s at --speed {speed:g} are more than {MOST_PICTURES} pictures; "
            "choose one trial with --trial, or a larger --speed"
        )
    server, scenes = _open(sessions, 0)
    try:
        show_all(scenes, [session.at(0.0) for session in sessions])
        recording = server.get_scene_serializer()
        for number in _pictures(sessions, speed):
            now = number * speed / PICTURES
            show_all(scenes, [session.at(now) for session in sessions])
            recording.insert_sleep(1.0 / PICTURES)
        names = [session.name for session in sessions]
        html = with_overlay(recording.as_html(), names, _looks(sessions), speed)
    finally:
        _stop(server)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, html)
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error.strerror}; choose another --html") from error


def _pictures(sessions: Sequence[RecordedSession], speed: float) -> range:
    duration = max(session.duration for session in sessions)
    return range(int(duration * PICTURES / speed) + 2)


def serve(sessions: Sequence[RecordedSession], port: int, speed: float, tell: Callable[[str], None]) -> None:
    """Show logs with a slider for the time, until Ctrl-C; `tell` is given the address."""
    server, scenes = _open(sessions, port)
    duration = max(session.duration for session in sessions)
    slider = server.gui.add_slider("time [s]", 0.0, round(duration, 3), 0.001, 0.0)
    rate = server.gui.add_slider("speed", 0.05, 1.0, 0.05, min(max(speed, 0.05), 1.0))
    playing = server.gui.add_checkbox("play", True)
    if len(sessions) > 1:
        server.gui.add_html(legend([session.name for session in sessions], _looks(sessions)))
    tell(f"http://{HOST}:{server.get_port()}")
    try:
        while True:
            if playing.value:
                ahead = slider.value + rate.value / PICTURES
                slider.value = ahead if ahead <= duration else 0.0
            with server.atomic():
                show_all(scenes, [session.at(slider.value) for session in sessions])
            time.sleep(1.0 / PICTURES)
    finally:
        _stop(server)


def serve_live(url: str, port: int, robot: str, tell: Callable[[str], None]) -> None:
    """Show a running session until Ctrl-C; `tell` is given the address.

    Raises:
        BusError: The bus cannot be opened.
    """
    bus = Bus(url)
    session = LiveSession(bus)
    server = _server(port)
    description = describe(robot)
    prepare_scene(server, description)
    scene = SessionScene(server, description, 0, None)
    tell(f"http://{HOST}:{server.get_port()}")
    picture = 0.0
    try:
        while True:
            bus.wait(1.0 / PICTURES)
            now = time.monotonic()
            if now >= picture:
                picture = now + 1.0 / PICTURES
                with server.atomic():
                    scene.show(session.at())
    finally:
        _stop(server)
