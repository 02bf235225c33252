"""What the server answers when it is asked: relative poses, and views that were clicked in."""

import time
from collections.abc import Callable

from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.correspondences.records import JournalError
from fleetpose.pose_server.messages import builders, relative_pose
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.messages import KeptView, View, ViewName
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.transport import Answer

Reply = Callable[[Site, ServerSettings, dict[str, str]], Answer]
"""Answers a query's parameters; in the server's own thread."""


def relative(site: Site, settings: ServerSettings, asked: dict[str, str]) -> Answer:
    """Answers `server/relative?from=a;to=b`."""
    a, b = asked.get("from"), asked.get("to")
    if not a or not b:
        return Answer(error="ask as server/relative?from=r1;to=r2")
    return _answer(relative_pose.relative_pose(site, a, b, settings, time.monotonic()))


def why(site: Site, settings: ServerSettings, asked: dict[str, str]) -> Answer:
    """Answers `server/why?robot=a`."""
    if not (name := asked.get("robot")):
        return Answer(error="ask as server/why?robot=r1")
    return _answer(builders.why_not(site, name, settings, time.monotonic()))


def _answer(found: Message | str) -> Answer:
    """A message, or the sentence that says why there is none."""
    if isinstance(found, str):
        return Answer(error=found)
    return Answer(pack(found), encoding_of(type(found)))


def journalled_view(journal: Journal, asked: dict[str, str]) -> Answer:
    """Answers `server/view?robot=r;epoch=e;seq=n` from the journal; in a thread of its own."""
    try:
        name = ViewName.model_validate({**asked, "seq": int(asked.get("seq", ""))})
        stored = journal.view(name)
    except (ValueError, JournalError) as error:
        reason = error if isinstance(error, JournalError) else "give robot, epoch and seq"
        return Answer(error=f"ask as server/view?robot=r1;epoch=0123456789ab;seq=7: {reason}")
    if stored is None:
        return Answer(error=f"view {name} is not in the journal: nobody clicked in it")
    view = unpack(View, stored.encoded)
    kept = KeptView(view=view, jpeg=stored.jpeg, image=stored.header)
    return Answer(pack(kept), encoding_of(KeptView))
