"""Measuring within a page, by scripts that are put into it: when an effect is on the screen.

A marker is drawn on a canvas; so calls of its context are looked at, and the effect counts as shown
at the frame after the one in which it was drawn. Times count from the event's own time stamp, which
the browser gives it before any script runs.
"""

from typing import Any

SETUP = """async () => {
    if (window.probe) return;
    const { state } = await import('/static/link/store.js');
    const probe = (window.probe = { armed: null, gaps: [[], []], views: [[], []] });
    const drawn = (context, kind, args) => {
        const armed = probe.armed;
        if (!armed || armed.drawn || !armed.at || context.canvas !== armed.canvas) return;
        if (!armed.fits(kind, args)) return;
        armed.drawn = true;
        requestAnimationFrame(() => armed.say.shown(performance.now() - armed.at));
    };
    for (const kind of ['fillText', 'drawImage']) {
        const own = CanvasRenderingContext2D.prototype[kind];
        CanvasRenderingContext2D.prototype[kind] = function (...args) {
            drawn(this, kind, args);
            if (kind === 'drawImage') this.canvas.lastDrawn = [args[1], args[2]];
            return own.apply(this, args);
        };
    }
    const begins = (event) => {
        const armed = probe.armed;
        if (armed && !armed.at && event.type === armed.event) armed.at = event.timeStamp;
    };
    for (const type of ['pointerup', 'keydown']) window.addEventListener(type, begins, true);
    const canvasOf = (side, kind) =>
        document.querySelector(`[data-panel=${side ? 'right' : 'left'}] canvas.${kind}`);
    const nextNumber = () => {
        const half = state.list.points.find((p) => p.status === 'half');
        return half ? half.n : 1 + Math.max(0, ...state.list.points.map((p) => p.n));
    };
    const MARK = (text) => (kind, args) => kind === 'fillText' && args[0] === text;
    const MOVE = (before) => (kind, args) =>
        kind === 'drawImage' && (args[1] !== before[0] || args[2] !== before[1]);
    probe.arm = (what, event, side) => {
        const canvas = canvasOf(side, 'loupe');
        const fits = what === 'mark' ? MARK(`${nextNumber()}`) : MOVE(canvas.lastDrawn ?? [0, 0]);
        const armed = (probe.armed = { canvas, event, fits, side, say: {} });
        for (const name of ['shown', 'confirmed'])
            armed[name] = new Promise((done) => (armed.say[name] = done));
        if (what !== 'mark') return;
        const confirmed = () => {
            if (probe.armed !== armed) return;
            const key = side ? 'pj' : 'pi';
            const [u, v] = (armed.at && state.cursors[side]) ?? [NaN, NaN];
            armed.pixel ??= armed.at && armed.drawn ? [u, v] : null;
            const [pu, pv] = armed.pixel ?? [NaN, NaN];
            const found = state.list.points.find(
                (p) => p[key] && Math.hypot(p[key][0] - pu, p[key][1] - pv) < 0.01);
            if (found && !['half', 'pending'].includes(found.status)) {
                requestAnimationFrame(() => armed.say.confirmed(performance.now() - armed.at));
            } else requestAnimationFrame(confirmed);
        };
        requestAnimationFrame(confirmed);
    };
    const seen = [null, null];
    const look = (now) => {
        for (const side of [0, 1]) {
            const view = state.images[side]?.view ?? null;
            if (view === null || view === seen[side]?.view) continue;
            if (seen[side]) probe.gaps[side].push(now - seen[side].now);
            seen[side] = { view, now };
            probe.views[side].push([view, performance.timeOrigin + now]);
        }
        requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
}"""
_ARM = "([what, event, side]) => window.probe.arm(what, event, side)"
_TAKE = """(name) => {
    const taken = window.probe[name];
    window.probe[name] = [[], []];
    return taken;
}"""
_TAKEN_MS = """([name, most_ms]) => Promise.race([
    window.probe.armed[name], new Promise((late) => setTimeout(() => late(null), most_ms))])"""


class Probe:
    """Times in a page, from an event to its effect on the screen."""

    def __init__(self, page: Any) -> None:
        self._page = page
        page.evaluate(SETUP)

    def arm(self, what: str, event: str, side: int) -> None:
        """Awaits the next event and its effect.

        Args:
            what: `mark`, the number of a new point in the loupe, or `move`, another place in it.
            event: `pointerup` or `keydown`.
            side: of the loupe.
        """
        self._page.evaluate(_ARM, [what, event, side])

    def shown_ms(self, timeout_s: float = 3.0) -> float | None:
        """How long it took until the effect was shown; None if it was not."""
        return self._read("shown", timeout_s)

    def confirmed_ms(self, timeout_s: float = 10.0) -> float | None:
        """How long it took until the point was shown as confirmed; None if it was not."""
        return self._read("confirmed", timeout_s)

    def gaps_s(self) -> list[float]:
        """The times between two images of a side since the last call."""
        return [gap / 1000 for side in self._page.evaluate(_TAKE, "gaps") for gap in side]

    def views(self) -> tuple[list[tuple[int, float]], list[tuple[int, float]]]:
        """Of each side: the numbers of the images that were shown since the last call, and when, in
        ms of the machine's clock.
        """
        left, right = self._page.evaluate(_TAKE, "views")
        return [tuple(one) for one in left], [tuple(one) for one in right]

    def _read(self, name: str, timeout_s: float) -> float | None:
        return self._page.evaluate(_TAKEN_MS, [name, 1000 * timeout_s])
