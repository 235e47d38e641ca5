"""The numbered exchange: the backend asks until the planner has answered, and the planner answers each question once.

Every request carries one message of the backend, every answer all that the planner said to it, so that whatever a
network loses, doubles, delays or reorders is repaired by sending one datagram again, and changes nothing else.
"""

import time
from collections.abc import Callable, Sequence

from imolo.errors import TrialVoidError
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE, Bus
from imolo_msgs import envelope_t, step_answer_t, step_request_t

FIRST_RESEND = 0.005  # [s] ten times what an answer takes on one machine
LAST_RESEND = 0.1  # [s]

Said = tuple[str, bytes]  # channel and bytes


class Asker:
    """The backend's side.

    Attributes:
        asked: Number of requests.
        resent: Number of times that one was sent again.
    """

    def __init__(self, bus: Bus, instance: int, watch: Callable[[], None]) -> None:
        """Join the bus.

        Args:
            bus: Where the planner is.
            instance: Of this backend.
            watch: Called again and again during the wait; raises what ends it.
        """
        self.asked = self.resent = 0
        self._bus, self._instance, self._watch = bus, instance, watch
        self._number = 0
        self._planner = 0
        self._answer: step_answer_t | None = None
        bus.subscribe_raw(self._on_answer, channels.STEP_ANSWER)

    def ask(self, planner: int, channel: str, data: bytes, first: bool, paced: bool) -> list[Said]:
        """Return what the planner says to a message.

        Args:
            planner: Instance of the planner of this trial; what others answer is not heard.
            channel: Of the message.
            data: Its bytes.
            first: Whether a trial starts with it.
            paced: Whether the trial runs in real time.

        Raises:
            TrialVoidError: The planner has not seen the trial from its start.
        """
        previous = 0 if first else self._number
        self._planner = planner
        self._number += 1
        self.asked += 1
        request = step_request_t()
        request.asking_backend = self._instance
        request.step_number, request.previous_step = self._number, previous
        request.paced = int(paced)
        request.asked = _envelope((channel, data))
        answer = self._exchange(request.encode())
        if answer.state_lost:
            raise TrialVoidError("the planner was started again during the trial")
        return [(one.inner_channel, one.inner_data) for one in answer.answers]

    def _exchange(self, request: bytes) -> step_answer_t:
        self._answer = None
        patience = FIRST_RESEND
        while True:
            self._bus.publish_raw(channels.STEP_REQUEST, request)
            deadline = time.monotonic() + patience
            while (left := deadline - time.monotonic()) > 0.0:
                self._bus.wait(left)
                if self._answer is not None:
                    return self._answer
                self._watch()
            self.resent += 1
            patience = min(2.0 * patience, LAST_RESEND)

    def _on_answer(self, _: str, data: bytes) -> None:
        try:
            answer = step_answer_t.decode(data)
        except UNREADABLE:
            self._bus.pass_over(channels.STEP_ANSWER)
            return
        named = answer.answering_planner, answer.answered_backend, answer.answered_step
        if named == (self._planner, self._instance, self._number):
            self._answer = answer


class Answerer:
    """The planner's side: handles each request once, in order, and repeats its answer when asked again.

    Attributes:
        repeated: Number of requests that were answered from memory.
    """

    def __init__(self, instance: int, answer: Callable[[step_request_t], Sequence[Said]]) -> None:
        """Wait for the start of a trial.

        Args:
            instance: Of this planner.
            answer: Handles a request and returns what the planner says to it.
        """
        self.repeated = 0
        self._instance, self._think = instance, answer
        self._backend = 0
        self._number = 0
        self._memory = b""

    def answer(self, data: bytes) -> bytes | None:
        """Return the answer to a request; None for one that nobody waits for any more."""
        request = step_request_t.decode(data)
        if request.asking_backend < self._backend:
            return None
        if request.asking_backend > self._backend:
            self._backend, self._number = request.asking_backend, 0
        if request.step_number < self._number:
            return None
        if request.step_number == self._number:
            self.repeated += 1
            return self._memory
        reply = step_answer_t()
        reply.answering_planner = self._instance
        reply.answered_backend, reply.answered_step = request.asking_backend, request.step_number
        if request.previous_step not in (0, self._number):
            reply.state_lost = 1
        else:
            reply.answers = [_envelope(said) for said in self._think(request)]
            reply.num_answers = len(reply.answers)
            self._number = request.step_number
        encoded: bytes = reply.encode()
        if not reply.state_lost:
            self._memory = encoded
        return encoded


def _envelope(said: Said) -> envelope_t:
    envelope = envelope_t()
    envelope.inner_channel, envelope.inner_data = said
    envelope.inner_size = len(envelope.inner_data)
    return envelope
