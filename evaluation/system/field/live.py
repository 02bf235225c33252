"""A small fleet of real processes, each with what its bundle gives it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fleetpose.deploy.local_fleet import ROBOT_NICE, LocalFleet, wait_running
from fleetpose.evaluation.system.field.site import Field
from fleetpose.evaluation.system.fleet import FleetPlan, RobotPlan, plan_world
from fleetpose.hmi_client.model.onlooker import Onlooker
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.messages import FleetState
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until

UP_WITHIN_S = 120.0


@dataclass
class Live:
    """A site whose fleet runs."""

    field: Field
    fleet: LocalFleet
    plan: FleetPlan

    @contextmanager
    def link(self, who: str) -> Iterator[Link]:
        """A session with somebody's certificate."""
        link = Link(open_session(self.settings(who)))
        try:
            yield link
        finally:
            link.close()

    def settings(self, who: str) -> SessionSettings:
        """Of a session with somebody's certificate."""
        return SessionSettings(config_file=self.field.configuration(who))

    @contextmanager
    def client(self, who: str) -> Iterator[OperatorSession]:
        """An operator's or observer's client, as the screen has it."""
        role, _, name = who.partition("/")
        session = (Onlooker if role == "observer" else OperatorSession)(name)
        settings = self.settings(who)
        with Client(session, self.field.keys, lambda: Link(open_session(settings))):
            yield session

    def wait(self, condition: Callable[[], bool], what: str, within_s: float = UP_WITHIN_S) -> None:
        """Waits while all processes run.

        Raises:
            FleetPoseError: it did not come about in time.
        """
        if not wait_running(self.fleet, condition, within_s):
            where = self.fleet.directory
            raise FleetPoseError(f"{what}: not within {within_s:.0f} s; the logs are in {where}")

    def wait_located(self) -> None:
        """Waits until every robot is located, as an observer hears it.

        Raises:
            FleetPoseError: they are not in two minutes.
        """
        located: list[int] = [0]

        def note(sample: Sample) -> None:
            try:
                state = unpack(FleetState, sample.payload, sample.encoding)
            except CodecError:
                return
            located[0] = sum(r.pose is not None and r.pose.located for r in state.robots)

        with self.link("observer/wall") as link:
            link.on_latched(self.field.keys.state, note)
            self.wait(lambda: located[0] >= len(self.plan.robots), "robots are not located")


@contextmanager
def live(
    folder: Path,
    logs: Path,
    robots: int = 3,
    routers: Sequence[str] = ("a",),
    located: bool = True,
    make: Callable[..., Field] = Field,
) -> Iterator[Live]:
    """Routers, world, server and robots from the bundles of a new site.

    Args:
        folder: for the site and the machines.
        robots: that stand in the synthetic world.
        routers: names.
        located: wait until all robots are.
        make: the site, given its folder and the names of robots and routers.

    Raises:
        FleetPoseError: they do not come up.
    """
    names = tuple(f"r{k + 1}" for k in range(robots))
    field = make(folder, robots=names, routers=tuple(routers))
    plan = plan_world(names, folder, moving=False, seed=0)
    with LocalFleet(logs) as fleet:
        it = Live(field, fleet, plan)
        for name in routers:
            start_router(it, name)
        fleet.start("world", "fleetpose.evaluation", *plan.world)
        start_server(it)
        it.wait(plan.truth.is_there, "the world does not start")  # pyright: ignore[reportAttributeAccessIssue]
        for robot in plan.robots:
            start_robot(it, robot)
        if located:
            it.wait_located()
        yield it


def router_process(name: str) -> str:
    """The name of its process and its log."""
    return f"router-{name}"


def start_router(it: Live, name: str) -> None:
    """Starts one and waits until it accepts connections."""
    config = it.field.configuration(f"router/{name}")
    process = router_process(name)
    it.fleet.start(process, "fleetpose.pose_server", "router", "--config", str(config))
    wait_accepting(it, name)


def wait_accepting(it: Live, name: str, within_s: float = 15.0) -> None:
    """Waits until a router accepts connections.

    Raises:
        FleetPoseError: it does not.
    """
    import socket

    address = it.field.router(name)

    def accepts() -> bool:
        try:
            socket.create_connection((address.host, address.port), timeout=0.5).close()
        except OSError:
            return False
        return True

    if not wait_until(accepts, within_s, poll_s=0.05):
        raise FleetPoseError(f"router {name} does not start: {it.fleet.tail(router_process(name))}")


def start_server(it: Live) -> None:
    """Starts the pose server."""
    state = ("--workers", "2", "--state-dir", str(it.field.folder / "state"))
    config = ("--config", str(it.field.configuration("server")))
    it.fleet.start("server", "fleetpose.pose_server", "run", *config, *state)


def wait_server(it: Live) -> None:
    """Waits until the pose server shows itself alive.

    Raises:
        FleetPoseError: it does not.
    """
    alive: list[str] = []
    with it.link("server") as link:
        link.on_alive(it.field.keys.server_alive("*"), lambda key, _: alive.append(key))
        it.wait(lambda: bool(alive), "the server does not start")


def start_robot(it: Live, robot: RobotPlan, nice: int = ROBOT_NICE) -> None:
    """Starts an agent as its unit would: configuration and settings from its machine's folder."""
    folder = it.field.install(f"robot/{robot.name}")
    settings = folder / "robot.toml"
    camera = f'name = "{robot.name}"\ncamera = "{robot.camera}"\ndata = "{robot.data}"\n'
    settings.write_text(camera)
    config = ("--config", str(folder / "zenoh.json5"), "--settings", str(settings))
    it.fleet.start(robot.name, "fleetpose.robot_agent", "run", *config, *robot.options, nice=nice)
