"""Bar 13: newcomers join a fleet and mend a wrong click."""

from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row, at_most
from fleetpose.evaluation.system.web.tryout import clicks_by_hand, tried

MOST_CLICKS, MOST_KEYS, MOST_MENDING, MOST_BY_HAND = 12, 15, 2, 40


def newcomers(bench: Bench) -> list[Row]:
    """What it takes on the demo's fleet from the first sight of the page to the joined fleet."""
    bench.site.silence_server(True)  # it would only take the demo's time
    found = tried(bench.out, bench.browser)
    data = bench.options.data
    by_hand = (
        None
        if data is None
        else clicks_by_hand(bench.out, bench.browser, data, bench.options.clouds)
    )
    what = "clicks on a recording, all points by hand"
    more = [] if by_hand is None else [at_most(13, what, by_hand, MOST_BY_HAND)]
    return [
        at_most(13, "clicks until a fleet is joined, by mouse alone", found["clicks"], MOST_CLICKS),
        at_most(13, "keys until it is joined, by keys alone", found["keys"], MOST_KEYS),
        at_most(13, "deeds that mend a wrong click", found["mended_actions"], MOST_MENDING),
        *more,
    ]
