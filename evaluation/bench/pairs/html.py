"""The report of `pose-eval pairs`: one HTML file that needs nothing beside it."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.pairs.calls import (
    MIN_OVERLAP,
    MIN_SHARED,
    UNSOLVED_BELOW_DEG,
    unsolved,
)
from fleetpose.evaluation.bench.pairs.pictures import side_by_side
from fleetpose.evaluation.bench.pairs.row import PairRow
from fleetpose.evaluation.bench.pairs.words import binned, listed, named_shares, tabled
from fleetpose.evaluation.data.recording import Recording
from fleetpose.evaluation.report.output import cell, scalars

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 1000px; color: #222 }
table { border-collapse: collapse; margin: .6em 0 1.4em; font-size: 13px }
td, th { padding: .2em .7em; border-bottom: 1px solid #ddd; text-align: right }
td { white-space: nowrap }
td:first-child, th:first-child { text-align: left }
th { vertical-align: bottom; font-weight: 600; max-width: 9em }
.wide { overflow-x: auto }
.plots img { width: 480px; max-width: 100% }
figure { margin: 1.2em 0 } figure img { max-width: 100% }
figcaption, .note { font-size: 13px; color: #555 }
.grave { color: #b00; font-weight: bold }
"""


def write_html(
    path: Path,
    recording: Recording,
    rows: Sequence[PairRow],
    summary: Mapping[str, Any],
    plots: Mapping[str, Path],
) -> None:
    """Writes the report: shares, plots, closest calls, and the pairs that were not solved."""
    of_clouds = f", {recording.clouds}" if recording.clouds else ""
    title = f"Pairs of {recording.directory.name}{of_clouds}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        *_shares(summary),
        "<h2>Numbers</h2>",
        _table(("", ""), listed(scalars(summary))),
        "<h2>Plots</h2><div class=plots>",
        *(_image(file.read_bytes(), "png", name) for name, file in plots.items()),
        "</div>",
        *_calls(summary["closest_calls"]),
        *_unsolved(recording, rows),
    ]
    path.write_text(
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _shares(summary: Mapping[str, Any]) -> Iterable[str]:
    yield "<h2>Shares</h2>"
    yield (
        "<p class=note>Of all pairs in question, answered or not. From, to: 95 % of bootstrap "
        "draws over views lie between; pairs of one view are not independent. All or none of the "
        "pairs gives no width, however few they are.</p>"
    )
    yield _table(*named_shares(summary["shares"]))
    if summary["success_overlap"]:
        yield "<h3>By overlap: answered and not gravely wrong</h3>"
        yield _table(*binned("overlap", summary["success_overlap"], True))
    yield "<h3>By angle</h3>"
    yield _table(*binned("angle", summary["by_angle"], False))


def _calls(calls: Mapping[str, Sequence[Mapping[str, Any]]]) -> Iterable[str]:
    yield "<h2>Closest calls</h2>"
    for title, some in (
        ("Verified, with the largest errors", calls["verified_largest_error"]),
        ("Gravely wrong, with the most support", calls["grave_most_support"]),
    ):
        yield f"<h3>{title}</h3>"
        yield _table(*tabled(some)) if some else "<p>None."


def _unsolved(recording: Recording, rows: Sequence[PairRow]) -> Iterable[str]:
    shown = unsolved(rows, recording.is_rgbd)
    enough = (
        f"an overlap of {MIN_OVERLAP:g}" if recording.is_rgbd else f"{MIN_SHARED} shared tracks"
    )
    yield f"<h2>Not solved: {len(shown)} shown</h2>"
    yield (
        f"<p class=note>Below {UNSOLVED_BELOW_DEG:g} degrees and with at least {enough}, yet not "
        "right. False verdicts first, then what should have been easiest; few per view. Dots: the "
        "other view's points at the true pose. Rings of one colour: one shared track.</p>"
    )
    views = {view.index: view for view in recording.views}
    for row in shown:
        i, j = views[row.i], views[row.j]
        picture = side_by_side(recording, i, j)
        seen = {"overlap": row.overlap, "shared tracks": row.shared}
        about = [f"{row.angle_deg:.0f} deg"]
        about += [f"{name} {cell(value)}" for name, value in seen.items() if value is not None]
        if row.position_error_m is not None:
            about.append(f"off by {row.position_error_m:.3g} m, {row.rotation_error_deg:.3g} deg")
        verdict = f"<span class={'grave' if row.grave else 'fair'}>{escape(row.verdict)}</span>"
        yield (
            f"<figure>{_image(picture, 'jpeg', f'{i.name} and {j.name}')}<figcaption>"
            f"<b>{row.i} {escape(i.name)}, {row.j} {escape(j.name)}</b>: "
            f"{escape(', '.join(about))}; {verdict}, {row.inliers} inliers: "
            f"{escape(row.reasons) or 'no reason given'}</figcaption></figure>"
        )


def _image(data: bytes, kind: str, name: str) -> str:
    text = base64.b64encode(data).decode()
    return f'<img alt="{escape(name)}" src="data:image/{kind};base64,{text}">'


def _table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = (
        "<tr>" + "".join(f"<td>{escape(cell(value))}</td>" for value in row) + "</tr>"
        for row in rows
    )
    return f"<div class=wide><table><tr>{head}</tr>\n" + "\n".join(body) + "</table></div>"
