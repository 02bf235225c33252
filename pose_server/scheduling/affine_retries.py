"""Pairs that the usual salient points leave open are tried again with wide sets, which their robots
make on demand.

A result that is not settled waits here until both robots have answered. Wide sets cost a robot up
to a second or two of its time, and most pairs of a large fleet have nothing in common: so only
pairs of robots that no verified alignment links are tried, the most alike first, a few at a time.
"""

from dataclasses import replace

from fleetpose.pose_server.registration.align import is_settled
from fleetpose.pose_server.scheduling.proposals import similarity
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.jobs import Done, Job
from fleetpose.protocol.messages import ViewName

MOST_SETS = 64  # about 250 kB each
_MOST_WAITING = 200
_MOST_ASKED = 4
_TRIES, _ONE_IN = 2, 8  # views of two robots tried again: a few, then one in so many alignments


def note_open(site: Site, done: Done) -> None:
    """Files a result that wide sets may settle."""
    i, j = done.job.i.name, done.job.j.name
    if _is_open(done) and (i, j) not in site.affine_retries.waiting and _may_try(site, i, j):
        site.affine_retries.waiting[i, j] = done
        site.affine_retries.tries[i.robot, j.robot] = (
            site.affine_retries.tries.get((i.robot, j.robot), 0) + 1
        )


def _is_open(done: Done) -> bool:
    """Whether a result of two robots leaves something to wide sets."""
    job = done.job
    tried = job.usual is not None or job.wide
    own = job.i.name.robot == job.j.name.robot
    if tried or own or not job.features or job.recipe != "full":
        return False
    return done.result is not None and not is_settled(done.result)


def _may_try(site: Site, i: ViewName, j: ViewName) -> bool:
    """Whether two views are worth their robots' time."""
    wide = site.affine_retries
    if len(wide.waiting) >= _MOST_WAITING or _is_answered(site, i, j):
        return False
    most = _TRIES + site.pair(i.robot, j.robot).alignments // _ONE_IN
    if wide.tries.get((i.robot, j.robot), 0) >= most:
        return False
    return all(view not in wide.refused and _lives(site, view) for view in (i, j))


def wanted(site: Site) -> list[ViewName]:
    """Views whose wide sets are to be asked for now."""
    wide = site.affine_retries
    if not wide.waiting or len(wide.asked) >= _MOST_ASKED:
        return []
    ranked = sorted(wide.waiting, key=lambda views: -_likeness(site, *views))
    missing = [v for views in ranked for v in views if v not in wide.sets and v not in wide.asked]
    ask = list(dict.fromkeys(missing))[: _MOST_ASKED - len(wide.asked)]
    wide.asked.update(ask)
    return ask


def receive(site: Site, view: ViewName, payload: bytes | None) -> None:
    """A robot has answered: with the view's wide set, or without."""
    wide = site.affine_retries
    wide.asked.discard(view)
    if payload is None:
        wide.refused[view] = None
        wide.refused = dict.fromkeys(list(wide.refused)[-_MOST_WAITING:])
        wide.close(view)
        return
    wide.sets[view] = payload
    while len(wide.sets) > MOST_SETS:
        wide.sets.popitem(last=False)


def wide_job(site: Site) -> Job | None:
    """A pair that has both its sets. Of one with clicks the clicks are aligned once more."""
    wide = site.affine_retries
    for (i, j), done in list(wide.waiting.items()):
        if i not in wide.sets or j not in wide.sets:
            continue
        del wide.waiting[i, j]
        record = site.pair(i.robot, j.robot)
        if i not in site.views or j not in site.views or _is_answered(site, i, j):
            continue
        if done.job.purpose == "clicks":
            record.clicks_due = True
            continue
        if record.running:
            wide.waiting[i, j] = done
            continue
        record.running = True
        site.count("wide_alignments")
        return replace(done.job, i=site.encoded(i), j=site.encoded(j), starts=(), usual=done.result)
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
    return similarity(site, i, j) if i in site.views and j in site.views else 0.0


def _lives(site: Site, view: ViewName) -> bool:
    robot = site.robots.get(view.robot)
    return robot is not None and robot.epoch == view.epoch
