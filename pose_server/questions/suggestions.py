"""Points to confirm that go with the operator's first questions."""

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.registration.suggested_points import apart_in_both
from fleetpose.pose_server.state.pairs import ViewPair
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import likely_matches, stands_still
from fleetpose.protocol.messages import Question, Suggestion, ViewName

Floats = npt.NDArray[np.floating]

_WITH_SUGGESTIONS = 5  # questions, the first ones
_MOST = 8


def with_suggestions(site: Site, asked: tuple[Question, ...]) -> tuple[Question, ...]:
    """The questions, the first of them with points to confirm in the views that they are about:
    those of now where a robot has not moved since, so that it still has the image.
    """
    first, rest = asked[:_WITH_SUGGESTIONS], asked[_WITH_SUGGESTIONS:]
    return (*(_suggesting(site, question) for question in first), *rest)


def _suggesting(site: Site, question: Question) -> Question:
    views, pixels = _matches(site, question)
    if not len(pixels) or views[0] not in site.views or views[1] not in site.views:
        return question
    view_i, view_j = (_of_now(site, view) for view in views)
    suggestions = tuple(Suggestion(pixel_i=row[:2], pixel_j=row[2:]) for row in pixels[:_MOST])
    update = {"view_i": view_i, "view_j": view_j, "suggestions": suggestions}
    return question.model_copy(update=update)


def _matches(site: Site, question: Question) -> tuple[ViewPair, Floats]:
    """Matches (M, 4) that aligning the pair came by, or, where that was never tried, what looks
    alike; and the views in which they were found.
    """
    record = site.pairs.get((question.i, question.j))
    if record is not None and record.last is not None and record.last_views is not None:
        suggested = record.last.suggested
        return record.last_views, np.zeros((0, 4)) if suggested is None else suggested
    views = (question.view_i, question.view_j)
    a, b = (site.views.get(view) for view in views)
    if a is None or b is None:
        return views, np.zeros((0, 4))
    pixels = likely_matches(a, b).astype(np.float64)
    height = min(a.camera.height, b.camera.height)
    return views, pixels[apart_in_both(pixels[:, :2], pixels[:, 2:], height)]


def _of_now(site: Site, view: ViewName) -> ViewName:
    """The newest view of the same robot, if that shows the same."""
    newest = site.newest_view(view.robot)
    if newest is None or newest.name == view or newest.name.epoch != view.epoch:
        return view
    return newest.name if stands_still(site.views[view], newest) else view
