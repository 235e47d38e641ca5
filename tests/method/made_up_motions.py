"""Motion templates of one to four parameters, for claims about any of them."""

from hypothesis import strategies as st
from liberobot import MOTION

from imolo.method.motion import Phase, PhasedMotion, PhaseParameter, Theta

K, T_W = MOTION.varied


def motion(*parameters: PhaseParameter, ends: tuple[float | None, ...], swing_phase: int) -> PhasedMotion:
    """Return a motion of two channels whose phases all ask for something else."""
    phases = tuple(Phase(target=(1.0 + 4.0 * number, 3.0), until=end) for number, end in enumerate(ends))
    return PhasedMotion(phases=phases, varied=parameters, swing_phase=swing_phase)


def target(name: str, phase: int, channel: int = 0, *, mirrored: bool = False) -> PhaseParameter:
    """Return a parameter that changes one channel in a phase."""
    direction = (1.0, 0.0) if channel == 0 else (0.0, 1.0)
    return PhaseParameter(name=name, phase=phase, direction=direction, range=(-1.0, 1.0), mirrored=mirrored)


def end(name: str, phase: int) -> PhaseParameter:
    """Return a parameter that ends a phase."""
    return PhaseParameter(name=name, unit="s", phase=phase)


def of_the_paper(*, k_phase: int = 1, open_phase: int = 2) -> PhasedMotion:
    """Return Liberobot's motion with k in another phase (c of Eq. 1), or with another free end (w of Eq. 3)."""
    ends = {1: (None, 0.5, 1.2), 2: (0.1, None, 1.2)}[open_phase]
    phases = (phase.model_copy(update={"until": until}) for phase, until in zip(MOTION.phases, ends, strict=True))
    varied = (K.model_copy(update={"phase": k_phase}), T_W.model_copy(update={"phase": open_phase}))
    changes = {"phases": tuple(phases), "varied": varied, "target_range": None}
    return PhasedMotion.model_validate({**MOTION.model_dump(), **changes})


OF_THE_PAPER = (
    MOTION,
    of_the_paper(k_phase=2),
    of_the_paper(k_phase=3),
    of_the_paper(open_phase=1),
    of_the_paper(k_phase=2, open_phase=1),
)
MADE_UP = (
    motion(target("k", 2), ends=(0.1, 0.5), swing_phase=2),
    motion(end("t", 1), ends=(None, 0.5), swing_phase=2),
    motion(end("t", 2), target("k", 2), target("m", 3, 1), ends=(0.1, None, 0.5), swing_phase=3),
    motion(end("t", 1), target("k", 1), target("l", 2), ends=(None, 0.5, 0.6), swing_phase=2),
    motion(
        target("k", 1, mirrored=True),
        target("l", 2, 1),
        end("t", 2),
        target("m", 3),
        ends=(0.1, None, 0.5),
        swing_phase=3,
    ),
    motion(target("k", 1), target("l", 1, 1), target("m", 2), end("t", 2), ends=(0.1, None, 0.5), swing_phase=3),
)
"""One, one, three, three, four and four parameters."""


@st.composite
def thetas(draw: st.DrawFn, template: PhasedMotion) -> Theta:
    """Draw a theta: targets on a lattice, so that two motions often share one, and whole milliseconds."""
    values = []
    for one in template.varied:
        low, high = template.bounds(one)
        if one.direction is None:
            values.append(draw(st.integers(round(low * 1e3) + 1, round(high * 1e3) - 1)) / 1e3)
        else:
            values.append(draw(st.integers(round(low * 4), round(high * 4))) / 4)
    return tuple(values)
