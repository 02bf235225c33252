"""Who says what at a site: the one policy from which all rules follow.

One function per role, from the site's keys to what that role says and hears; nothing here knows
how routers write rules.
"""

from dataclasses import dataclass, fields

from fleetpose.protocol.keys import EVERY_SERVER, Keys

ADMIN = "@/*/router"
"""What a router tells of itself: its version, and the metadata of its configuration."""


@dataclass(frozen=True)
class Permissions:
    """Key expressions that somebody may use, by what they do there.

    Attributes:
        latches: puts that are kept for late readers (advanced publisher).
        puts: plain ones.
        answers: queries that it answers.
        shows: liveliness tokens.
        follows: latched keys that it hears, with what was said before.
        hears: plain subscriptions.
        asks: queries.
        sees: tokens that it looks for and watches.
    """

    latches: tuple[str, ...] = ()
    puts: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    shows: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    sees: tuple[str, ...] = ()

    def __add__(self, other: "Permissions") -> "Permissions":
        names = [field.name for field in fields(self)]
        return Permissions(**{name: getattr(self, name) + getattr(other, name) for name in names})


def permissions(keys: Keys, role: str, name: str) -> Permissions:
    """What somebody may do, except a router; the name `*` stands for all of a role."""
    of_role = {
        "server": lambda: _server(keys),
        "robot": lambda: _robot(keys, name),
        "operator": lambda: _people(keys) + _operator(keys, name),
        "observer": lambda: _people(keys),
        "recorder": lambda: _recorder(keys),
        "health": lambda: _people(keys) + _health(keys),
    }[role]
    return of_role() + _own_check(keys, role, name)


def _server(keys: Keys) -> Permissions:
    told = (keys.alignment("*", "*"), keys.correspondences("*", "*"), keys.state, keys.status)
    return Permissions(
        latches=(*told, keys.receipts("*"), keys.poses, keys.heard("*")),
        answers=(keys.relative, keys.why, keys.server_view),
        shows=(keys.server_alive("*"),),
        follows=(
            *(keys.updates("*"), keys.selection("*"), keys.odometry("*")),
            *(keys.camera("*"), keys.denials("*")),
        ),
        hears=(keys.cloud("*"),),
        asks=(keys.view("*"),),
        sees=(keys.server_alive("*"), keys.robot_alive("*", "*")),
    )


def _robot(keys: Keys, name: str) -> Permissions:
    return Permissions(
        latches=(keys.camera(name), keys.odometry(name)),
        puts=(keys.cloud(name), keys.image(name)),
        answers=(keys.view(name),),
        shows=(keys.robot_alive(name, "*"),),
        follows=(keys.poses, keys.heard(name)),
        asks=(keys.relative, keys.why),
        sees=(keys.robot_alive(name, "*"), keys.server_alive("*"), EVERY_SERVER),
    )


def _people(keys: Keys) -> Permissions:
    """What everybody who looks at the fleet hears."""
    return Permissions(
        follows=(
            *(keys.state, keys.status, keys.poses, keys.alignment("*", "*")),
            *(keys.correspondences("*", "*"), keys.camera("*"), keys.selection("*")),
        ),
        hears=(keys.image("*"),),
        asks=(keys.view("*"), keys.server_view, keys.why),
        sees=(keys.server_alive("*"), EVERY_SERVER),
    )


def _recorder(keys: Keys) -> Permissions:
    """All that is said at the site, and nothing of its own; also what only the server hears."""
    return Permissions(
        follows=(
            *(keys.camera("*"), keys.odometry("*"), keys.updates("*"), keys.selection("*")),
            *(keys.receipts("*"), keys.poses, keys.state, keys.status, keys.heard("*")),
            *(keys.denials("*"), keys.alignment("*", "*"), keys.correspondences("*", "*")),
        ),
        hears=(keys.cloud("*"), keys.image("*")),
        sees=(keys.server_alive("*"), keys.robot_alive("*", "*"), EVERY_SERVER),
    )


def _operator(keys: Keys, name: str) -> Permissions:
    return Permissions(
        latches=(keys.updates(name), keys.selection(name)),
        follows=(keys.receipts(name),),
    )


def _health(keys: Keys) -> Permissions:
    return Permissions(
        follows=(keys.denials("*"),), asks=(ADMIN,), sees=(keys.robot_alive("*", "*"),)
    )


def _own_check(keys: Keys, role: str, name: str) -> Permissions:
    """A key on which `pose-deploy check` hears itself by way of the router."""
    key = keys.check(role, name, "*")
    return Permissions(puts=(key,), hears=(key,))


def everybody(keys: Keys) -> list[Permissions]:
    """The permissions of each role, all its members taken together."""
    named = ("robot", "operator", "observer", "recorder", "health")
    return [
        permissions(keys, "server", "server"),
        *(permissions(keys, role, "*") for role in named),
    ]
