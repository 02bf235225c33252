"""The fleet of a soak: a site with certificates and two routers. Its robots walk; their links can
be slowed and cut, their clocks set, and the disk of the server filled.
"""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.deploy.manifest import CONFIGURATION
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.system.field.live import Live, start_router
from fleetpose.evaluation.system.field.site import Field
from fleetpose.evaluation.system.fleet import FleetPlan, RobotPlan, plan_world
from fleetpose.evaluation.system.observer import SeenView
from fleetpose.evaluation.system.soak.disk import Disk
from fleetpose.evaluation.system.soak.relay import Relay
from fleetpose.evaluation.system.soak.stepping import MODULE, set_clock
from fleetpose.evaluation.system.truth import WorldTruth
from fleetpose.protocol.errors import FleetPoseError

ROUTERS = ("a", "b")
MAX_SALIENT = 800
"""Salient points of a view, half of what is usual: two cores then carry four robots and the world
that they see.
"""
STARTED_WITHIN_S = 300.0
"""Generous: on a machine that has more to do, imports and textures take minutes."""
RESTLESS, DESK_OPERATOR = "anna", "ben"
"""Who clicks in this process, and who at a desk that can be killed."""


class SteppedTruth(WorldTruth):
    """Truth of robots whose clocks are set now and then: a stamp is that of a world's moment by
    the clock as it is or as it was.
    """

    def __init__(self, truth_file: Path, robots: tuple[str, ...]) -> None:
        super().__init__(truth_file, {name: name for name in robots})
        self.ahead_ns = dict.fromkeys(robots, 0)
        self._steps_ns: dict[str, set[int]] = {name: {0} for name in robots}

    def set(self, robot: str, ahead_ns: int) -> None:
        """A robot's clock is set, by so much off the true time."""
        self._steps_ns[robot].add(ahead_ns)
        self.ahead_ns[robot] = ahead_ns

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        for ahead_ns in tuple(self._steps_ns.get(seen.view.name.robot, ())):
            stamp_ns = seen.view.stamp_ns - ahead_ns
            view = seen.view.model_copy(update={"stamp_ns": stamp_ns})
            if (T := super().T_world_robot(replace(seen, view=view))) is not None:
                return T
        return None


@dataclass
class SoakSite:
    """The site while it runs.

    Attributes:
        it: site, processes and robots.
        relays: the robots' links, by robot.
        disk: the server's; none where nothing may be mounted.
    """

    it: Live
    truth: SteppedTruth
    folder: Path
    disk: Disk | None
    relays: dict[str, Relay] = field(default_factory=dict)

    @property
    def fleet(self) -> LocalFleet:
        return self.it.fleet

    @property
    def robots(self) -> tuple[str, ...]:
        return self.it.plan.names

    def install(self, who: str) -> Path:
        """Installs a bundle on its machine; robots reach the routers by their relay. The folder."""
        folder = self.it.field.install(who)
        role, _, name = who.partition("/")
        if role == "robot":
            told = json.loads((folder / CONFIGURATION).read_text())
            endpoints = told["connect"]["endpoints"]
            for router, port in self.relays[name].ports.items():
                address = self.it.field.router(router).endpoint
                through = f"tls/127.0.0.1:{port}"
                endpoints = [one.replace(address, through) for one in endpoints]
            told["connect"]["endpoints"] = endpoints
            (folder / CONFIGURATION).write_text(json.dumps(told))
        return folder

    def set_clock(self, robot: str, ahead_ns: int) -> None:
        """Sets a robot's clock, by so much off the true time."""
        self.truth.set(robot, ahead_ns)
        set_clock(self._clock(robot), ahead_ns)

    def start_robot(self, robot: RobotPlan) -> None:
        """Starts an agent as its unit would, on a machine of its own: it shares this one's cores
        with the server, but not as the one who waits.
        """
        ports = {name: self.it.field.router(name).port for name in ROUTERS}
        self.relays[robot.name] = Relay(ports)
        folder = self.install(f"robot/{robot.name}")
        self.set_clock(robot.name, 0)
        settings = folder / "robot.toml"
        told: dict[str, object] = {"name": robot.name, "camera": robot.camera, "data": robot.data}
        told |= {"rate_hz": robot.rate_hz, "max_salient": MAX_SALIENT}
        lines = [f"{key} = {json.dumps(value)}\n" for key, value in told.items()]
        settings.write_text("".join(lines))
        files = ("--config", str(folder / CONFIGURATION), "--settings", str(settings))
        clock = str(self._clock(robot.name))
        self.fleet.start(robot.name, MODULE, clock, "run", *files)

    def close(self) -> None:
        for relay in self.relays.values():
            relay.close()

    def _clock(self, robot: str) -> Path:
        return self.folder / f"{robot}.clock"


@contextmanager
def soak_site(
    folder: Path, logs: Path, robots: int, rate_hz: float, seed: int
) -> Iterator[SoakSite]:
    """Routers, world, server and walking robots from the bundles of a new site.

    Raises:
        FleetPoseError: they do not come up.
    """
    names = tuple(f"r{k + 1}" for k in range(robots))
    site = Field(folder, robots=names, operators=(RESTLESS, DESK_OPERATOR), routers=ROUTERS)
    plan = _plan(folder, names, rate_hz, seed)
    assert isinstance(plan.truth, SteppedTruth)
    with ExitStack() as closing:
        disk = _disk(folder / "state")
        if disk is not None:
            closing.callback(disk.close)
        fleet = LocalFleet(logs)
        soak = SoakSite(Live(site, fleet, plan), plan.truth, folder, disk)
        closing.callback(soak.close)
        closing.enter_context(fleet)
        for name in ROUTERS:
            start_router(soak.it, name)
        fleet.start("world", "fleetpose.evaluation", *plan.world)
        options = ("--workers", "2", "--state-dir", str(folder / "state"))
        config = ("--config", str(site.configuration("server")))
        fleet.start("server", "fleetpose.pose_server", "run", *config, *options)
        soak.it.wait(plan.truth.is_there, "the world does not start", STARTED_WITHIN_S)
        for robot in plan.robots:
            soak.start_robot(robot)
        yield soak


def _plan(folder: Path, names: tuple[str, ...], rate_hz: float, seed: int) -> FleetPlan:
    plan = plan_world(names, folder, moving=True, seed=seed)
    robots = tuple(replace(robot, rate_hz=rate_hz) for robot in plan.robots)
    return replace(plan, robots=robots, truth=SteppedTruth(folder / "truth", names))


def _disk(folder: Path) -> Disk | None:
    try:
        return Disk(folder)
    except (FleetPoseError, OSError) as error:
        print(f"the disk of the server is not filled: {error}; run as root for that")
        return None
