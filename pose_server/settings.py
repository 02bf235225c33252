"""Settings of the pose server; file and environment (`FLEETPOSE_SERVER_*`) overlay the defaults."""

import os
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field
from pydantic_settings import SettingsConfigDict

from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.protocol.settings import Endpoints, Name, ProcessSettings

RecipeName = Literal["full", "paper"]


class ServerSettings(ProcessSettings):
    """How a pose server runs. Every default works."""

    model_config = SettingsConfigDict(env_prefix="FLEETPOSE_SERVER_")
    roles: ClassVar[tuple[str, ...]] = ("server",)

    site: Name = Field("demo", description="name of the site, a chunk of every key")
    listen: Endpoints = Field((), description="be the router as well, on these endpoints")
    connect: Endpoints = Field((), description="endpoints of the router")
    config: Path | None = Field(None, description="zenoh configuration (JSON5) that replaces both")
    connect_timeout_s: float = Field(
        -1.0, description="wait so long for a router at the start; negative: for ever"
    )
    state_dir: Path = Field(Path("fleetpose-state"), description="where the journal is kept")
    workers: int = Field(
        default_factory=lambda: max(1, min(16, os.cpu_count() or 1)),
        ge=1,
        le=256,
        description="alignment processes; if not told, one for each core, at most 16",
    )
    cluster: str | None = Field(
        None, description="align on this Dask cluster instead, e.g. tcp://10.0.0.1:8786"
    )
    anchor: Name | None = Field(
        None, description="robot whose first keyframe is the origin of the fleet"
    )
    skip_pairs: Path | None = Field(
        None, description="file with lines 'r1 r2': pairs that only the operator may start"
    )
    recipe: RecipeName = Field(
        "full", description="how pairs are aligned: full, or paper (the method as published)"
    )
    icp: IcpMethod = Field(
        "gicp",
        description="how clouds are brought together: gicp (from point to point where they are "
        "sparse), point_to_point or point_to_plane by Open3D, off",
    )
    state_hz: float = Field(4.0, gt=0, le=20, description="rate of the fleet's state, at most")
    metrics: str | None = Field(
        None, description="serve the status to Prometheus at HOST:PORT, or at PORT of this machine"
    )
    takeover: bool = Field(False, description="start even if another server of the site is alive")
    fresh_s: float = Field(
        5.0, gt=0, description="a pose older than this does not count as located"
    )
    located_sigma: float = Field(
        0.05,
        gt=0,
        description="largest position sigma of a located robot, share of the median depth",
    )
    located_grave: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="largest probability that a located robot is gravely off",
    )
    weight_clicks: float = Field(
        Weights.clicks,
        ge=0,
        description="what three live correspondences add to a pair's weight, as a share of it",
    )
    weight_error: float = Field(
        Weights.error,
        ge=0,
        description="the most that its last error adds; 1 % of the depth adds its own weight once",
    )
    retry_s: float = Field(
        Weights.retry_s,
        gt=0,
        description="rest of a pair whose alignment failed, before it is tried again with a view "
        "that changed; each failure in a row doubles it",
    )
