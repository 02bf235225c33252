"""History of questions and answers."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from fleetpose.pose_server.questions.ranking import CLICKS_TO_JOIN, FleetUncertainty
from fleetpose.pose_server.state.pairs import ViewPair
from fleetpose.protocol.keys import RobotPair
from fleetpose.protocol.messages import Answer, Question

Client = tuple[str, str]

_MOST_CLIENTS = 64
_MOST_ANSWERS = 10
_MOST_LOOKED = 10_000
_FRUITLESS = 0.2  # of the predicted gain


@dataclass(frozen=True)
class Look:
    """A pair on an operator's screen: since when, and how many correspondences it had then."""

    pair: RobotPair
    keyframes: ViewPair
    since_s: float
    correspondences: int


@dataclass
class Open:
    """Clicks in a pair whose effect is still being watched.

    Attributes:
        predicted_m: drop of the mean sigma per click, as the pair was asked for.
        before: how the fleet stood.
        told: whether an event said what they did.
    """

    pair: RobotPair
    predicted_m: float
    before: FleetUncertainty
    clicks: int = 0
    told: bool = False

    def note_click(self) -> None:
        """One more."""
        self.clicks += 1

    def tell(self) -> None:
        """An event said what they did."""
        self.told = True


@dataclass(frozen=True)
class Asked:
    """Questions, and from what they were ranked, when: the parts of the fleet and who is asked
    about, and the numbers, which change with every solve. `shown` are the same with suggestions,
    about views of now.
    """

    parts: object = None
    numbers: object = None
    at_s: float = float("-inf")
    questions: tuple[Question, ...] = ()
    shown: tuple[Question, ...] | None = None
    shown_s: float = float("-inf")


@dataclass
class QuestionFeedback:
    """History of questions and answers.

    Attributes:
        looks: what each operator's client shows now.
        in_vain: how often keyframes were looked at without a click.
        open: the pair that was clicked in last.
        answers: the newest last; that of the open pair still changes.
        asked: the questions as they were ranked last.
    """

    looks: dict[Client, Look] = field(default_factory=dict)
    in_vain: dict[ViewPair, int] = field(default_factory=dict)
    open: Open | None = None
    answers: tuple[Answer, ...] = ()
    asked: Asked = Asked()

    def times_in_vain(self, pairs: Sequence[ViewPair]) -> int:
        """How often an operator looked at any of these keyframes in vain."""
        return sum(self.in_vain.get(views, 0) for views in dict.fromkeys(pairs))

    def fruitless(self, pair: RobotPair) -> int:
        """Sets of three clicks in a pair of joined robots that did far less than was expected."""
        return sum(
            answer.clicks // CLICKS_TO_JOIN
            for answer in self.answers
            if (answer.i, answer.j) == pair
            and not answer.joined
            and answer.realised < _FRUITLESS * answer.predicted
        )

    def turn(self, client: Client, look: Look | None) -> None:
        """An operator's client shows another pair, or none."""
        self.looks.pop(client, None)
        if look is not None:
            fresh = list(self.looks.items())[-_MOST_CLIENTS + 1 :]
            self.looks = dict([*fresh, (client, look)])

    def note_vain(self, keyframes: ViewPair) -> None:
        """An operator looked at two keyframes without a click."""
        if keyframes in self.in_vain or len(self.in_vain) < _MOST_LOOKED:
            self.in_vain[keyframes] = self.in_vain.get(keyframes, 0) + 1

    def begin(self, opened: Open, answer: Answer) -> None:
        """A pair is clicked in; the effect on the one before is final."""
        self.open = opened
        self.answers = (*self.answers, answer)[-_MOST_ANSWERS:]

    def renew(self, answer: Answer) -> None:
        """What the clicks in the open pair did so far."""
        self.answers = (*self.answers[:-1], answer)

    def ask(self, asked: Asked) -> None:
        """The questions are these from now on."""
        self.asked = asked
