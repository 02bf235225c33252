"""What `pose-eval ros` is asked for. Nothing heavy is imported."""

from dataclasses import dataclass

from fleetpose.evaluation.options.building import told

DIALECTS = ("jazzy", "humble", "ros2dds")


@dataclass(frozen=True)
class RosOptions:
    """Which stand-ins for robots run, and for how long."""

    dialect: tuple[str, ...] = told(
        "How a robot speaks: jazzy, humble, ros2dds; repeatable. [default: one of each]", ()
    )
    seconds: float = told("With the whole fleet.", 30.0, min=15)
    cost_seconds: float = told("Of each robot's frames alone, for their cost.", 15.0, min=3)
    rate: float = told("Views per second of each agent.", 1.0, min=0.1)
    seed: int = told("Of the town and of noise.", 0)
