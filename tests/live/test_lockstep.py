"""The numbered exchange without a network: whatever order requests come in, each is handled once and answered alike."""

from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st

from imolo.live.lockstep import Answerer, Said
from imolo.messaging import channels
from imolo_msgs import envelope_t, step_answer_t, step_request_t

PLANNER = 77


class Echo:
    """Handles a request by counting it."""

    def __init__(self) -> None:
        self.handled: list[tuple[int, int]] = []

    def __call__(self, request: step_request_t) -> Sequence[Said]:
        self.handled.append((request.asking_backend, request.step_number))
        return [(channels.PLAN, bytes([len(self.handled) % 256])), (channels.ACTUATOR_COMMAND, b"")]


def request(number: int, first: bool = False, backend: int = 5) -> bytes:
    message = step_request_t()
    message.asking_backend, message.step_number = backend, number
    message.previous_step = 0 if first else number - 1
    message.asked = envelope_t()
    data: bytes = message.encode()
    return data


@given(st.lists(st.integers(0, 11), max_size=60))
def test_each_request_is_handled_once_in_order_whatever_copies_arrive(copies: list[int]) -> None:
    """A backend asks n + 1 only after the answer to n; copies of old requests may come at any time."""
    handled = Echo()
    answerer = Answerer(PLANNER, handled)
    answers: dict[int, bytes] = {}
    asked = 1
    for number in [1, *copies]:
        if number == 0 or number > asked:
            asked += 1
            number = asked
        answer = answerer.answer(request(number, first=number == 1))
        if number < asked:
            assert answer is None
        else:
            assert answer is not None
            assert answers.setdefault(number, answer) == answer
    assert handled.handled == [(5, number) for number in range(1, asked + 1)]


def test_answer_carries_all_that_was_said_in_its_order() -> None:
    data = Answerer(PLANNER, Echo()).answer(request(1, first=True))
    assert data is not None
    answer = step_answer_t.decode(data)
    assert (answer.answering_planner, answer.answered_backend, answer.answered_step) == (PLANNER, 5, 1)
    assert [(one.inner_channel, one.inner_data) for one in answer.answers] == [
        (channels.PLAN, b"\x01"),
        (channels.ACTUATOR_COMMAND, b""),
    ]
    assert answer.state_lost == 0


def test_planner_that_came_late_says_so_until_the_next_trial() -> None:
    handled = Echo()
    answerer = Answerer(PLANNER, handled)
    for number in (17, 17, 18):
        data = answerer.answer(request(number))
        assert data is not None
        assert step_answer_t.decode(data).state_lost == 1
    assert handled.handled == []
    data = answerer.answer(request(19, first=True))
    assert data is not None
    assert step_answer_t.decode(data).state_lost == 0
    assert handled.handled == [(5, 19)]


def test_requests_of_a_backend_that_was_replaced_are_not_heard() -> None:
    handled = Echo()
    answerer = Answerer(PLANNER, handled)
    assert answerer.answer(request(30, first=True, backend=5)) is not None
    assert answerer.answer(request(1, first=True, backend=6)) is not None
    assert answerer.answer(request(31, backend=5)) is None
    assert answerer.answer(request(2, backend=6)) is not None
    assert handled.handled == [(5, 30), (6, 1), (6, 2)]
