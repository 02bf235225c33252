"""What routers let through of one robot or operator, so that nobody takes the others' share."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from fleetpose.protocol.keys import Keys


class Rates(BaseModel):
    """Limits of each connection; what is beyond them is dropped by the router, without a word."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    views_hz: float = Field(5.0, gt=0, description="clouds and images of a robot, per second")
    odometry_hz: float = Field(60.0, gt=0, description="odometry of a robot, per second")
    questions_hz: float = Field(20.0, gt=0, description="queries of relative poses, per second")
    view_bytes: int = Field(2_000_000, ge=65_536, description="of one cloud, image or kept view")
    small_bytes: int = Field(65_536, ge=4096, description="of any other message, bytes")


def limits(keys: Keys, rates: Rates) -> dict[str, Any]:
    """The parts of a router's configuration that limit rates, sizes and priorities.

    Operators' updates are not thinned out: they come in bursts, and each one counts.
    """
    bulk = [keys.cloud("*"), keys.image("*")]
    odometry, camera = keys.odometry("*"), keys.camera("*")
    small = [odometry, camera, keys.updates("*"), keys.selection("*")]
    puts = {
        **dict.fromkeys(bulk, rates.views_hz),
        odometry: rates.odometry_hz,
        f"{odometry}/@adv/**": 10.0,
        camera: 5.0,
    }
    ingress = {"flows": ["ingress"]}
    return {
        "downsampling": [
            {"id": "puts", **ingress, "messages": ["put"], "rules": _thinned(puts)},
            {
                "id": "questions",
                **ingress,
                "messages": ["query"],
                "rules": _thinned(dict.fromkeys((keys.relative, keys.why), rates.questions_hz)),
            },
        ],
        "low_pass_filter": [
            _bounded("small", small, rates.small_bytes),
            _bounded("views", [*bulk, keys.view("*")], rates.view_bytes),
        ],
        # whatever a robot asks for, its views never go before poses and clicks
        "qos": {
            "network": [
                {
                    "id": "views",
                    **ingress,
                    "messages": ["put"],
                    "key_exprs": bulk,
                    "overwrite": {"priority": "data_low", "express": False},
                }
            ]
        },
    }


def _thinned(rates_hz: dict[str, float]) -> list[dict[str, Any]]:
    return [{"key_expr": key, "freq": rate} for key, rate in rates_hz.items()]


def _bounded(name: str, keys: list[str], size: int) -> dict[str, Any]:
    return {
        "id": name,
        "flows": ["ingress"],
        "messages": ["put", "reply"],
        "key_exprs": keys,
        "size_limit": size,
    }
