"""Pairs that the usual salient points leave open are tried again with wide sets, which their robots
make on demand.

A result that is not settled waits here until both robots have answered. Wide sets cost a robot up
to a second or two of its time, and most pairs of a large fleet have nothing in common: so only
pairs of robots that no verified alignment links are tried, the most alike first, a few at a time.
"""

from fleetpose.pose_server.registration.align import is_settled
from fleetpose.pose_server.state.affine_retries import MOST_WAITING
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.jobs import ClickJob, Done, Job, RetryJob
from fleetpose.protocol.messages import ViewName

_MOST_ASKED = 4
_TRIES, _ONE_IN = 2, 8  # views of two robots tried again: a few, then one in so many alignments


def note_open(site: Site, done: Done) -> None:
    """Files a result that wide sets may settle."""
    i, j = done.job.i.name, done.job.j.name
    if _is_open(done) and (i, j) not in site.affine_retries.waiting and _may_try(site, i, j):
        site.affine_retries.wait(done)


def _is_open(done: Done) -> bool:
    """Whether a result of two robots leaves something to wide sets."""
    job = done.job
    tried = isinstance(job, RetryJob) or job.affine
    own = job.i.name.robot == job.j.name.robot
    if tried or own or not job.features or job.recipe != "full":
        return False
    return done.result is not None and not is_settled(done.result)


def _may_try(site: Site, i: ViewName, j: ViewName) -> bool:
    """Whether two views are worth their robots' time."""
    wide = site.affine_retries
    if len(wide.waiting) >= MOST_WAITING or _is_answered(site, i, j):
        return False
    most = _TRIES + site.pair(i.robot, j.robot).alignments // _ONE_IN
    if wide.tries.get((i.robot, j.robot), 0) >= most:
        return False
    return all(view not in wide.declined and _lives(site, view) for view in (i, j))


def wanted(site: Site) -> list[ViewName]:
    """Views whose wide sets are to be asked for now."""
    wide = site.affine_retries
    if not wide.waiting or len(wide.asked) >= _MOST_ASKED:
        return []
    ranked = sorted(wide.waiting, key=lambda views: -_likeness(site, *views))
    missing = [v for views in ranked for v in views if v not in wide.sets and v not in wide.asked]
    ask = list(dict.fromkeys(missing))[: _MOST_ASKED - len(wide.asked)]
    wide.ask(ask)
    return ask


def receive(site: Site, view: ViewName, payload: bytes | None) -> None:
    """A robot has answered: with the view's wide set, or without."""
    site.affine_retries.answer(view, payload)


def wide_job(site: Site) -> Job | None:
    """A pair that has both its sets. Of one with clicks the clicks are aligned once more."""
    wide = site.affine_retries
    for (i, j), done in list(wide.waiting.items()):
        if i not in wide.sets or j not in wide.sets:
            continue
        record = site.pair(i.robot, j.robot)
        useless = i not in site.views or j not in site.views or _is_answered(site, i, j)
        by_clicks = isinstance(done.job, ClickJob)
        if record.running and not (useless or by_clicks):
            continue
        wide.take((i, j))
        if by_clicks and not useless:
            record.make_due("clicks")
        if by_clicks or useless:
            continue
        assert done.result is not None  # it is open
        record.start()
        site.count("wide_alignments")
        return RetryJob(site.encoded(i), site.encoded(j), before=done.result)
    return None


def _is_answered(site: Site, i: ViewName, j: ViewName) -> bool:
    """Whether a verified alignment links the two robots already, or others join them; what an
    operator clicked is worth more than that.
    """
    record = site.pair(i.robot, j.robot)
    if record.best is not None and record.best.verdict == "verified":
        return True
    return not site.correspondences.has(i.robot, j.robot) and site.joined(i, j)


def _likeness(site: Site, i: ViewName, j: ViewName) -> float:
    return site.similarity(i, j) if i in site.views and j in site.views else 0.0


def _lives(site: Site, view: ViewName) -> bool:
    robot = site.robots.get(view.robot)
    return robot is not None and robot.epoch == view.epoch
