"""The commands of the hardware, found through the entry points `imolo.commands`; each imports what it needs itself."""

import getpass
from pathlib import Path
from typing import Annotated

import typer

from imolo.command_line.options import Config

app = typer.Typer()

BOARD = "127.0.0.1:7705"  # `imolo_drivers.board.server.PORT`
MOTIVE_PORT = 1510  # of NatNet's commands
MOTIVE = f"127.0.0.1:{MOTIVE_PORT}"
LONGEST_LINE = 400  # characters of what a board says of itself
EMULATED_TIMESTEP = 2.5e-4  # [s] a third of a core for MuJoCo; a YAML may ask for another one

BoardAddress = Annotated[str, typer.Argument(metavar="HOST[:PORT]", help="Where the valve board listens.")]
Listen = Annotated[str, typer.Option(metavar="HOST:PORT", help="Where to listen for the planner's computer.")]
Secret = Annotated[Path | None, typer.Option(metavar="FILE", help="What the board must know, too; mode 0600.")]
Person = Annotated[str, typer.Option(help="Who, for the log of the board.", show_default="the user")]


@app.command()
def board(
    config: Annotated[Path | None, typer.Argument(help="YAML of the board, see docs/hardware.md.")] = None,
    listen: Listen = BOARD,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Do everything but move.")] = False,
    vent: Annotated[bool, typer.Option("--vent", help="Give all channels 0 and end, after a board that died.")] = False,
) -> None:
    """Run the valve board, which vents when control is lost.

    It follows commands and tells pressures. Without a config its valves are simulated. It moves nothing before a
    person says `imolo arm`.
    """
    from imolo.config.reading import read_model
    from imolo.live.program import Console, in_background, until_stopped
    from imolo.machine.priority import BOARD_PRIORITY, claim_priority
    from imolo_drivers.address import parse_address
    from imolo_drivers.board.config import BoardConfig
    from imolo_drivers.board.server import BoardServer
    from imolo_drivers.board.supervision import Supervisor, every_signal
    from imolo_drivers.board.valve_io import IioValves, SimulatedValves

    chosen = read_model(config, BoardConfig, "name its converters under `iio`") if config else BoardConfig()
    chosen = chosen.model_copy(update={"dry_run": chosen.dry_run or dry_run})
    where = parse_address(listen)
    if vent:
        valves = IioValves(chosen.iio) if chosen.iio else SimulatedValves()
        valves.write((0.0,) * len(chosen.channels))
        typer.echo(f"{chosen.name}: all {len(chosen.channels)} channels vented")
        return
    with until_stopped() as stop, every_signal(stop.ask), in_background(Console("board").say) as say:
        valves = IioValves(chosen.iio) if chosen.iio else SimulatedValves()
        server, supervisor = BoardServer(chosen, valves, where, say), Supervisor()
        kind = "IIO converters" if chosen.iio else "simulated valves"
        dry = ", dry run" if chosen.dry_run else ""
        known = "no secret: whoever is on this machine can arm" if server.is_open else "clients must know the secret"
        priority = claim_priority(BOARD_PRIORITY)
        say(f"{chosen.name} on {server.address[0]}:{server.address[1]}, {kind}{dry}, {priority}, {known}, vented")
        supervisor.ready()
        server.run(lambda: bool(stop), supervisor.turned)


@app.command()
def arm(where: BoardAddress = BOARD, person: Person = "", secret: Secret = None) -> None:
    """Allow the connected controller to move the robot.

    Asks before. Valid for that connection alone: after every loss of the link, and for every trial, a person arms
    again.
    """
    from imolo.errors import BackendError
    from imolo_drivers.address import parse_address
    from imolo_drivers.board.board import BoardState
    from imolo_drivers.board.client import PATIENCE, BoardClient
    from imolo_drivers.board.handshake import ClientRole
    from imolo_drivers.board.refusal import quote
    from imolo_drivers.board.secret import read_secret

    address, name = parse_address(where), person or getpass.getuser()
    known = read_secret(secret) if secret else b""
    client = BoardClient(address, ClientRole.OPERATOR, name, PATIENCE, secret=known)
    client.close()
    welcome = client.welcome
    state = BoardState(welcome.state_at_welcome).name.lower()
    cause = f" ({welcome.cause_at_welcome})" if welcome.cause_at_welcome else ""
    dry = ", dry run" if welcome.is_dry_run else ""
    typer.echo(quote(f"{welcome.board_name}, {welcome.board_robot}: {state}{cause}{dry}", LONGEST_LINE))
    if not welcome.controller_session:
        raise BackendError("there is no controller to arm; start it first")
    limits = sorted({f"{channel.target_limit:g} {channel.channel_unit}" for channel in welcome.board_channels})
    channels = f"{welcome.num_board_channels} channels, up to {', '.join(limits)}"
    typer.echo(quote(f"controller: {welcome.controller_name}; {channels}", LONGEST_LINE))
    # Not typer's prompt, after which Ctrl-C would be an exit code of 1.
    if input("Is everybody clear of the robot? Type 'arm' to arm it: ") != "arm":
        raise BackendError("not armed")
    client = BoardClient(address, ClientRole.OPERATOR, name, PATIENCE, secret=known)
    client.wait(lambda: client.state.state_number > 0, PATIENCE)
    session, before = welcome.controller_session, client.state.num_armed
    client.arm(session, name, welcome.entered_at_welcome)

    def is_answered() -> bool:
        return bool(client.state.armed_session == session or client.state.num_armed != before or client.refusals)

    if not client.wait(is_answered, PATIENCE):
        raise BackendError("the board does not say that it is armed")
    client.close()
    if client.refusals:
        raise BackendError(client.refusals[-1].refusal_reason)
    if client.state.armed_session != session:
        raise BackendError(f"the board was armed and has latched at once: {client.state.state_cause}")
    typer.echo("armed; `imolo disarm` vents")


@app.command()
def disarm(where: BoardAddress = BOARD, person: Person = "") -> None:
    """Vent the robot and take the permission to move back, at once.

    Needs no secret.
    """
    from imolo_drivers.address import parse_address
    from imolo_drivers.board.client import disarm as vent

    name = person or getpass.getuser()
    vent(parse_address(where), name)
    typer.echo(f"vented: disarmed by {name}")


@app.command()
def calibrate(
    config: Annotated[
        str, typer.Argument(metavar="CONFIG", help="A YAML with `backend: {name: hardware}`, or hardware.")
    ],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the calibration here.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, max=60.0, help="How long to watch the robot.")] = 2.0,
) -> None:
    """Find where the cameras' frame lies, from the robot at rest.

    The robot is in its ready pose. Prints how far each marker is from where it should be, and what to put into the
    config.
    """
    from imolo.config.loading import backend_options, body_of, named_config
    from imolo.errors import ConfigError
    from imolo_drivers.calibrate import calibrate as watch_and_fit
    from imolo_drivers.hardware_backend import HardwareOptions

    chosen = named_config(config)
    options = backend_options(chosen)
    if not isinstance(options, HardwareOptions):
        raise ConfigError(f"{config} is for {chosen.backend.name!r}, which has no cameras; name the backend hardware")
    calibration, errors = watch_and_fit(options.cameras, body_of(chosen.robot), seconds, options.patience)
    for name, error in sorted(errors.items(), key=lambda item: -item[1]):
        typer.echo(f"{name:15s} {1e3 * error:5.1f} mm off")
    typer.echo(f"{'all':15s} {1e3 * calibration.residual:5.1f} mm, root mean square")
    if out is None:
        typer.echo(f"\n{calibration.to_yaml()}\ngive --out calibration.yaml to keep it")
    else:
        calibration.save(out)
        typer.echo(f"\nwritten to {out}; put this into {config}:\n\nbackend:\n  calibration: {out.absolute()}")


@app.command()
def emulate(
    engine: Config,
    listen: Listen = BOARD,
    motive: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where Motive is to answer.")] = MOTIVE,
    armed: Annotated[bool, typer.Option("--armed", help="Arm every trial at once, in the place of a person.")] = False,
    calibration: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where Motive's frame lies, as `imolo calibrate` writes it.")
    ] = None,
    secret: Secret = None,
) -> None:
    """Be the robot on the network, with an engine behind.

    Valve board and motion capture, in real time. For `backend: {name: hardware}` where no robot is at hand.
    """
    from imolo.config.loading import named_config
    from imolo.live.program import Console, in_background, until_stopped
    from imolo.machine.priority import BOARD_PRIORITY, claim_priority
    from imolo_drivers.address import parse_address
    from imolo_drivers.board.config import BoardConfig
    from imolo_drivers.emulator import EmulatedRobot
    from imolo_drivers.natnet.calibration import Calibration
    from imolo_drivers.natnet.config import NatNetServerConfig

    config = named_config(engine, simulation={"timestep": EMULATED_TIMESTEP})
    host, port = parse_address(motive, MOTIVE_PORT)
    cameras = NatNetServerConfig.model_validate({"address": host, "command_port": port})
    with until_stopped() as stop, in_background(Console("emulate").say) as say:
        frame = Calibration.load(calibration) if calibration else Calibration()
        board = BoardConfig.model_validate({"robot": config.robot.name, "secret": secret})
        robot = EmulatedRobot(config, board, parse_address(listen), cameras, armed, say, frame)
        where = robot.board.address
        priority = claim_priority(BOARD_PRIORITY)
        ports = f"board on {where[0]}:{where[1]}, Motive on {host}:{robot.motive.port}"
        say(f"{config.backend.name}: {ports}, {priority}")
        robot.run(lambda: bool(stop))
        say(f"stopped; {robot.lost:.1f} s lost")
