"""A fleet whose robots are in the air, as a process of its own, because it lives in a network of
its own: router, server and operators at the site, each robot in a network behind one radio link.
"""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.options.field import FieldOptions, RadioLink
from fleetpose.evaluation.options.fleets import FleetOptions
from fleetpose.evaluation.system.field.clicking import Clicking, clicking
from fleetpose.evaluation.system.field.live import (
    Live,
    start_robot,
    start_router,
    start_server,
    wait_server,
)
from fleetpose.evaluation.system.field.site import Field
from fleetpose.evaluation.system.fleet import FleetPlan, RobotPlan, plan_fleet
from fleetpose.evaluation.system.radio.ages import Ages, Look, SentView, sent_views
from fleetpose.evaluation.system.radio.link import Station
from fleetpose.evaluation.system.radio.namespaces import Namespace, enter, set_kernel
from fleetpose.evaluation.system.truth import WorldTruth

SITE = "10.77.0.1"
CLICKS_PER_S = 1.0
BACK_WITHIN_S = 120.0
_ROBOT = "10.77.0.{}"
_FIRST_ROBOT = 11
_PROCESS = "radio"


@dataclass(frozen=True)
class Cell:
    """What one run is told.

    Attributes:
        congestion: of TCP, on all machines.
        folder: for the site and what robots see.
        logs: for logs.
    """

    link: RadioLink
    congestion: str
    robots: int
    seconds: float
    outage_s: float
    seed: int
    data: str | None
    clouds: str | None
    folder: str
    logs: str

    @classmethod
    def of(cls, options: FieldOptions, congestion: str, folder: Path, logs: Path) -> "Cell":
        """For what `pose-eval field` is asked for."""
        assert options.radio is not None
        data = None if options.data is None else str(options.data.absolute())
        where = (str(folder.absolute()), str(logs.absolute()))
        how = (options.robots, options.seconds, options.outage, options.seed)
        return cls(options.radio, congestion, *how, data, options.clouds, *where)


def run(cell: Cell) -> dict[str, Any]:
    """Runs it in networks of its own; what it measured.

    Raises:
        FleetPoseError: the fleet does not come up.
    """
    with _in_the_air(cell) as it, ExitStack() as closing:
        began_s = time.monotonic()
        link = closing.enter_context(it.link("observer/wall"))
        ages = Ages(link, it.field.keys, it.plan.names)
        it.wait(ages.all_located, "robots are not located")
        located_s = time.monotonic() - began_s
        screen = closing.enter_context(it.client("operator/ben"))
        it.wait(lambda: set(it.plan.names[:2]) <= set(screen.robots()), "the screen hears nothing")
        screen.select(*it.plan.names[:2])
        operator = closing.enter_context(clicking(it, CLICKS_PER_S))
        told = _watch(it, cell, ages, operator)
        if cell.outage_s:
            told |= _outage(it, cell, ages, operator)
        told |= operator.account()
    return {"first_located_s": located_s, **told, "left": it.fleet.leftover_processes()}


def _watch(it: Live, cell: Cell, ages: Ages, operator: Clicking) -> dict[str, Any]:
    before, began_s, clicked_s = it.fleet.told(_PROCESS)[-1], time.time(), time.monotonic()
    looks = ages.watch(cell.seconds, it.fleet.check)
    seconds, after = time.time() - began_s, it.fleet.told(_PROCESS)[-1]
    sent = [
        view
        for robot in it.plan.names
        for view in sent_views((it.fleet.directory / f"{robot}.log").read_text())
        if began_s <= view.put_s
    ]
    return {
        **_of_looks(looks, len(it.plan.names)),
        **_spread("pose_age_on_arrival_s", ages.on_arrival_s(began_s)),
        **_of_views(sent, ages, seconds * len(it.plan.names)),
        **_spread("click_s", operator.clicker.waited_s(clicked_s, time.monotonic())),
        **_of_link(before, after, seconds),
    }


def _of_looks(looks: Sequence[Look], robots: int) -> dict[str, Any]:
    ages_s = [age_s for look in looks for age_s in look.ages_s]
    located = sum(look.located for look in looks)
    return {"located_share": located / (robots * len(looks)), **_spread("pose_age_s", ages_s)}


def _of_views(sent: Sequence[SentView], ages: Ages, robot_seconds: float) -> dict[str, Any]:
    took_s = [ages.first_s[v.name] - v.put_s for v in sent if v.name in ages.first_s]
    return {
        "views_per_s": len(sent) / robot_seconds,
        "view_kB": float(np.mean([view.bytes for view in sent])) / 1000,
        "salient": float(np.mean([view.salient for view in sent])),
        "views_without_pose": len(sent) - len(took_s),
        **_spread("view_to_pose_s", took_s),
    }


def _of_link(before: dict[str, Any], after: dict[str, Any], seconds: float) -> dict[str, Any]:
    """What the link carried of each kind of station, and what it lost."""

    def grown(what: str, site: bool) -> int:
        ends = [told["stations"] for told in (after, before)]
        late, early = (
            sum(one[what] for name, one in end.items() if (name == "site") == site) for end in ends
        )
        return late - early

    told = {}
    for way, site in (("up", False), ("down", True)):
        told[f"{way}_kbit_s"] = 8 * grown("bytes", site) / 1000 / seconds
        told[f"{way}_lost"], told[f"{way}_full"] = grown("lost", site), grown("full", site)
    return told


def _spread(name: str, values: Sequence[float]) -> dict[str, Any]:
    if not values:
        return {f"{name}_p50": None, f"{name}_p95": None, f"{name}_max": None}
    p50, p95, most = (float(np.percentile(values, share)) for share in (50, 95, 100))
    return {f"{name}_p50": p50, f"{name}_p95": p95, f"{name}_max": most}


def _outage(it: Live, cell: Cell, ages: Ages, operator: Clicking) -> dict[str, Any]:
    """Takes the link down for a while; how long after it all robots are located again."""
    began_s = time.monotonic()
    it.fleet.signal(_PROCESS, "SIGUSR1")
    looks = ages.watch(cell.outage_s, it.fleet.check)
    it.fleet.signal(_PROCESS, "SIGUSR2")
    up_s, up_ns = time.monotonic(), time.time_ns()
    it.wait(lambda: ages.all_newer(up_ns), "robots do not come back", BACK_WITHIN_S)
    back_s = time.monotonic() - up_s
    it.wait(ages.all_located, "robots are not located again", BACK_WITHIN_S)
    return {
        "outage_located_at_its_end": looks[-1].located,
        "outage_back_s": back_s,
        "outage_located_again_s": time.monotonic() - up_s,
        **_spread("outage_click_s", operator.clicker.waited_s(began_s, time.monotonic())),
    }


@contextmanager
def _in_the_air(cell: Cell) -> Iterator[Live]:
    """Takes this process into the site's network, and starts everybody where they belong.

    All that is made here is gone with this process and those that it starts.
    """
    folder = Path(cell.folder)
    data = () if cell.data is None else (Path(cell.data),)
    fleet_options = FleetOptions(robots=cell.robots, data=data, clouds=cell.clouds, seed=cell.seed)  # pyright: ignore[reportArgumentType]
    plan = plan_fleet(fleet_options, folder)
    site, robots = Namespace(), {name: Namespace() for name in plan.names}
    enter(site.path)
    field = Field(folder, robots=plan.names, host=SITE)
    with LocalFleet(Path(cell.logs)) as fleet:
        it = Live(field, fleet, plan)
        for namespace in (site, *robots.values()):
            with namespace.entered():
                set_kernel(_kernel(cell.congestion))
        _start_link(it, cell, site, robots)
        start_router(it, "a")
        start_server(it)
        wait_server(it)
        for robot in plan.robots:
            with robots[robot.name].entered():
                _start_world(it, robot)
        for robot in plan.robots:
            with robots[robot.name].entered():
                start_robot(it, robot, nice=0)  # its computer is its own
        yield it


def _kernel(congestion: str) -> dict[str, str]:
    """What a bundle tells the kernel of its machine, with another congestion control."""
    text = (files("fleetpose.deploy") / "files" / "sysctl.conf").read_text()
    lines = (line.split("=", 1) for line in text.splitlines() if not line.startswith("#"))
    told = {name.strip(): value.strip() for name, value in lines}
    of_network = {name: value for name, value in told.items() if name.startswith("net.ipv4.")}
    return {
        **of_network,
        "net.ipv4.tcp_congestion_control": congestion,
        "net.ipv6.conf.all.disable_ipv6": "1",
    }


def _start_link(it: Live, cell: Cell, site: Namespace, robots: dict[str, Namespace]) -> None:
    stations = [Station("site", f"{SITE}/24", site.path)]
    stations += [
        Station(name, f"{_ROBOT.format(_FIRST_ROBOT + number)}/24", namespace.path)
        for number, (name, namespace) in enumerate(robots.items())
    ]
    told = [json.dumps(asdict(one)) for one in stations]
    module = "fleetpose.evaluation.system.radio.link"
    link = json.dumps(asdict(cell.link))
    it.fleet.start(_PROCESS, module, link, str(cell.seed), *told, json_lines=True)
    it.wait(lambda: bool(it.fleet.told(_PROCESS)), "the radio link is not there")


def _start_world(it: Live, robot: RobotPlan) -> None:
    """The synthetic world, if there is one, once more beside each robot: images do not go through
    the air.
    """
    plan: FleetPlan = it.plan
    if not isinstance(plan.truth, WorldTruth):
        return
    arguments = list(plan.world)
    where = arguments.index("--truth-file") + 1
    first = robot is plan.robots[0]
    truth = Path(arguments[where]) if first else it.field.folder / f"truth-{robot.name}"
    arguments[where] = str(truth)
    it.fleet.start(f"world-{robot.name}", "fleetpose.evaluation", *arguments)
    it.wait(truth.exists, "the world does not start")


def main() -> None:
    """Argument: what a `Cell` is told, as JSON. Prints what it measured as a line of JSON."""
    told = json.loads(sys.argv[1])
    cell = Cell(**told | {"link": RadioLink(**told["link"])})
    print(json.dumps(run(cell)), flush=True)


if __name__ == "__main__":
    main()
