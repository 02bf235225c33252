"""What `pose-eval field` is asked for. Nothing heavy is imported."""

from dataclasses import dataclass
from pathlib import Path

from fleetpose.evaluation.options.building import Text, told
from fleetpose.evaluation.options.names import CloudKind
from fleetpose.evaluation.options.recorded import CLOUDS


@dataclass(frozen=True)
class RadioLink:
    """A radio channel that all robots share.

    Attributes:
        rate_kbit: kbit/s, both directions and all robots together.
        delay_ms: of a packet, in each direction.
        loss: share of packets, each by chance.
    """

    rate_kbit: float
    delay_ms: float
    loss: float


def _radio(option: str, text: str) -> RadioLink | None:
    from fleetpose.protocol.errors import FleetPoseError

    if not text:
        return None
    try:
        rate_kbit, delay_ms, loss = (float(part) for part in text.split(","))
    except ValueError:
        rate_kbit = delay_ms = loss = -1.0
    if not (rate_kbit > 0 and delay_ms >= 0 and 0 <= loss < 1):
        raise FleetPoseError(f"{option} {text!r}: write RATE_KBIT,DELAY_MS,LOSS like 2000,50,0.05")
    return RadioLink(rate_kbit, delay_ms, loss)


RADIO = Text(
    _radio,
    lambda link: "" if link is None else "{rate_kbit:g},{delay_ms:g},{loss:g}".format(**vars(link)),
)


@dataclass(frozen=True)
class FieldOptions:
    """What `pose-eval field` is asked for; what is not told is left out."""

    attacks: bool = told(
        "Have members and strangers say, hear, ask and answer what they may not.",
        False,
        "--attacks",
    )
    silent: bool = told("Break robots' links in ten ways; is the cause named?", False, "--silent")
    rotate: bool = told(
        "Renew, revoke, and change the rules while clicks go on.", False, "--rotate"
    )
    routers: int = told("Of the site, for --kills.", 2, min=1, max=2)
    kills: int = told("Kill a router so many times under clicks.", 0, min=0)
    flood: bool = told("Have a robot send as fast as it can.", False, "--flood")
    cost: bool = told(
        "Clicks and CPU with TLS and access control, beside a plain router.", False, "--cost"
    )
    radio: RadioLink | None = told(
        "Put the robots behind a shared radio link: RATE_KBIT,DELAY_MS,LOSS, e.g. 2000,50,0.05.",
        None,
        text=RADIO,
    )
    seconds: float = told("For --radio, with each of TCP's reno and bbr.", 60.0, min=5)
    outage: float = told("For --radio: the link is down for so many seconds.", 0.0, min=0)
    data: Path | None = told("For --radio: posed views that robots show; else they stand there.")
    clouds: CloudKind | None = told(CLOUDS)
    robots: int = told("That stand in the synthetic world.", 3, min=3, max=8)
    quiet_s: float = told("Without attacks, to count false alarms.", 60.0, "--quiet", min=1)
    seed: int = told("Which routers are killed, and when; which packets are lost.", 0)
