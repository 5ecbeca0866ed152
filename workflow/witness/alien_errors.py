"""Errors of a rig in forms that nobody has modelled: noise that lasts, comes in bursts or has long
tails, gains that step, wander and level off, places that creep, coarse states, clocks that jitter.

    draw(rng)                                  one to three of the open kinds, each with its size
    draw(rng, sealed=True)                     likewise, one at least of the sealed kinds
    reported(states, errors)                   the states as reported by robot, load cell and clock
    read(clean, errors, states, noise_V, rng)  the board's readings from noise-free ones

Sizes are log-uniform from a tenth to three times those of an ordinary rig (`FORMS`). No error
follows place, force or the direction of loading, and none lasts: its mean over recordings is zero,
and what is slow has zero mean over a recording too. A third of the kinds, by lot, is sealed: nobody
tunes anything on them.
"""

import hashlib
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from witness.rig_errors import MAX_KINDS, RigError, Usual, drawn_size, elapsed_share, walk

LOT = 1  # the seed of what is sealed
BANKS = 4  # converters, that take the channels in turn
TAIL_DOF = 3  # of Student's t
FARTHEST = 6.0  # sd of a long tail, beyond which there is none


@dataclass(frozen=True)
class Timeline:
    """What errors know of a recording. time_s, share (N,): time, and its elapsed share; press (N,):
    number of the press, negative where untouched; begun (N,): number of presses that have begun;
    acting (N,): frames in which an error acts."""

    time_s: np.ndarray
    share: np.ndarray
    press: np.ndarray
    begun: np.ndarray
    acting: np.ndarray

    @property
    def presses(self) -> int:
        """Number of presses, at least 1."""
        return max(int(self.press.max()) + 1, 1)


# Makes `count` courses (N, count) of an error, of sd 1 where nothing else is said.
Course = Callable[[np.random.Generator, Timeline, int], np.ndarray]


def _white(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    return rng.standard_normal((len(line.share), count))


def _lasting(white: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(N, K): of sd 1, of white noise (N, K); kept (N,): what is left of the frame before."""
    lasting = white.copy()
    fresh = np.sqrt(1.0 - kept**2)
    for row in range(1, len(white)):
        lasting[row] = kept[row] * lasting[row - 1] + fresh[row] * white[row]
    return lasting


def _in_frames(low: float, high: float) -> Course:
    """Ornstein-Uhlenbeck; of a frame low to high is left in the next."""

    def course(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
        kept = np.full(len(line.share), rng.uniform(low, high))
        return _lasting(_white(rng, line, count), kept)

    return course


def _in_seconds(low_s: float, high_s: float) -> Course:
    """Ornstein-Uhlenbeck; 1/e is left after low_s to high_s."""

    def course(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
        kept = np.exp(-np.diff(line.time_s, prepend=line.time_s[0]) / _between(rng, low_s, high_s))
        return _lasting(_white(rng, line, count), kept)

    return course


def _two_paced(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Half its variance lasts for a few frames, half for tens of them."""
    fast, slow = _in_frames(0.5, 0.8), _in_frames(0.96, 0.99)
    return (fast(rng, line, count) + slow(rng, line, count)) / np.sqrt(2.0)


def _flicker(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Power over frequency, in frames, falls as 1/f^0.8 to 1/f^1.2; zero mean over a recording."""
    number = len(line.share)
    waves = np.arange(number // 2 + 1)
    root = np.zeros(len(waves))
    root[1:] = waves[1:] ** (-0.5 * rng.uniform(0.8, 1.2))
    spectrum = np.fft.rfft(rng.standard_normal((number, count)), axis=0) * root[:, None]
    twice = np.where((waves == 0) | (2 * waves == number), 1.0, 2.0)
    return np.fft.irfft(spectrum, number, axis=0) / np.sqrt((twice * root**2).sum() / number)


def _long_tailed(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Student's t, a frame; of sd 1 but for what is beyond FARTHEST."""
    return _tails(rng, (len(line.share), count))


def _tails(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    scale = np.sqrt(TAIL_DOF / (TAIL_DOF - 2.0))
    return np.clip(rng.standard_t(TAIL_DOF, shape) / scale, -FARTHEST, FARTHEST)


def _outliers(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """1 to 5 % of single readings are off by 2/3 to 4/3."""
    shape = len(line.share), count
    is_off = rng.uniform(size=shape) < rng.uniform(0.01, 0.05)
    return is_off * rng.choice([-1.0, 1.0], shape) * rng.uniform(2.0 / 3.0, 4.0 / 3.0, shape)


def _bursts(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """One to four stretches of 4 to 20 frames."""
    loud = np.zeros(len(line.share))
    for _ in range(int(rng.integers(1, 5))):
        first = int(rng.integers(len(loud)))
        loud[first : first + int(rng.integers(4, 21))] = 1.0
    return loud[:, None] * _white(rng, line, count)


def _growing(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Of sd 1 at the end."""
    return line.share[:, None] * _white(rng, line, count)


def _few_columns(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """White in one to five columns."""
    bad = rng.choice(count, min(count, int(rng.integers(1, 6))), replace=False)
    return np.isin(np.arange(count), bad) * _white(rng, line, count)


def _across_neighbours(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """White in time, the running mean of 3 to 9 columns."""
    width = int(rng.integers(3, 10))
    wide = _white(rng, line, count + width - 1)
    window = np.lib.stride_tricks.sliding_window_view(wide, width, axis=1)
    return window.sum(axis=2) / np.sqrt(width)


def _shared(course: Course) -> Course:
    """One course in all columns, normal times as large in each."""

    def shared(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
        return rng.standard_normal(count) * course(rng, line, 1)

    return shared


def _walk(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """A random walk, as long a step every frame, of sd 1 at the end before its mean is off."""
    return walk(rng, np.linspace(0.0, 1.0, len(line.share)), count)


def _steps(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Two to five normal steps at random frames."""
    number = int(rng.integers(2, 6))
    frame = rng.integers(1, len(line.share), number)
    is_after = np.arange(len(line.share))[:, None] >= frame
    return is_after @ rng.standard_normal((number, count))


def _one_step(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """A normal step of one column, at a random frame."""
    is_after = np.arange(len(line.share)) >= rng.integers(1, len(line.share))
    return np.outer(is_after, rng.standard_normal() * (np.arange(count) == rng.integers(count)))


def _between_presses(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Renewed when a press begins."""
    return rng.standard_normal((int(line.begun.max()) + 1, count))[line.begun]


def _levelling(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """exp(-t / tau), tau 3 to 15 % of the recording."""
    fading = np.exp(-line.share / rng.uniform(0.03, 0.15))
    return np.outer(fading, rng.standard_normal(count))


def _sine(low_s: float, high_s: float) -> Course:
    """A sine wave; its period is low_s to high_s."""

    def course(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
        turns = line.time_s / _between(rng, low_s, high_s)
        phase = rng.uniform(size=count)
        return np.sqrt(2.0) * np.sin(2.0 * np.pi * (turns[:, None] + phase))

    return course


def _saw(low_s: float, high_s: float) -> Course:
    """Rising and falling in straight lines; its period is low_s to high_s."""

    def course(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
        turns = line.time_s / _between(rng, low_s, high_s)
        phase = (turns[:, None] + rng.uniform(size=count)) % 1.0
        return np.sqrt(3.0) * (4.0 * np.abs(phase - 0.5) - 1.0)

    return course


def _each_press(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    return rng.standard_normal((line.presses, count))[line.press]


def _each_press_long_tailed(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    return _tails(rng, (line.presses, count))[line.press]


def _each_press_either(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """1 or -1, a press."""
    return rng.choice([-1.0, 1.0], (line.presses, count))[line.press]


def _over_presses(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """A random walk from press to press, of sd 1 at the last before its mean is off."""
    step = rng.standard_normal((line.presses, count)) / np.sqrt(max(line.presses - 1, 1))
    return np.cumsum(step, axis=0)[line.press]


def _within_press(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """In every press from 0, in straight lines, to 1 in sd."""
    end = _each_press(rng, line, count)
    share = np.zeros(len(line.share))
    for press in range(line.presses):
        rows = np.flatnonzero(line.press == press)
        share[rows] = np.linspace(0.0, 1.0, len(rows))
    return share[:, None] * end


def _relaxing(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """In every press from 1 in sd to 0: exp(-t / tau), tau 2 to 20 s."""
    tau_s = _between(rng, 2.0, 20.0)
    since_s = np.zeros(len(line.share))
    for press in range(line.presses):
        rows = np.flatnonzero(line.press == press)
        since_s[rows] = line.time_s[rows] - line.time_s[rows[:1]]
    return np.exp(-since_s / tau_s)[:, None] * _each_press(rng, line, count)


def _jitter(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
    """Uniform, so that no frame comes before another."""
    return rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), (len(line.share), count))


def _centred(course: Course) -> Course:
    """With zero mean over the frames in which it acts: a lasting part would be an effect."""

    def centred(rng: np.random.Generator, line: Timeline, count: int) -> np.ndarray:
        values = course(rng, line, count)
        return values - values[line.acting].mean(axis=0) if line.acting.any() else values

    return centred


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


ON = {  # unit and target by what an error acts on
    "noise": ("noise sd", "readings"),  # added to a channel, times the sd of its noise
    "channel": ("median |v|", "readings"),  # added to a channel
    "common": ("median |v|", "readings"),  # added to all channels alike
    "reading": ("1", "readings"),  # of a reading
    "gain": ("1", "readings"),  # of all channels
    "bank": ("1", "readings"),  # of the channels of a converter
    "place": ("mm", "states"),
    "force": ("N", "states"),
    "load-cell": ("1", "states"),  # of the force
    "clock": ("s", "states"),
    "coarse-place": ("mm", "states"),  # a step, to whose multiples it is rounded
    "coarse-force": ("N", "states"),
    "coarse-clock": ("s", "states"),
}


@dataclass(frozen=True)
class Form:
    """A kind of error: its size on an ordinary rig; what it acts on, a key of ON; its course, None
    where values are rounded."""

    size: float
    on: str
    course: Course | None = None

    @property
    def usual(self) -> Usual:
        """Its size with unit and target."""
        return Usual(self.size, *ON[self.on])


# Sizes are our choice where nothing is said. Noise of a size of 1 doubles the white noise's
# variance; what is slow is told before its mean is off; what grows at its end, what fades at its
# start.
FORMS = {
    "lasting-noise": Form(1.0, "noise", _in_frames(0.6, 0.95)),  # a filter behind the demodulator
    "slow-noise": Form(1.0, "noise", _centred(_in_seconds(3.0, 120.0))),
    "two-paced-noise": Form(1.0, "noise", _centred(_two_paced)),
    "flicker-noise": Form(1.0, "noise", _flicker),  # 1/f of amplifiers
    "noise-bursts": Form(5.0, "noise", _bursts),  # a motor that runs for a while
    "long-tailed-noise": Form(1.0, "noise", _long_tailed),
    "outliers": Form(4.5, "noise", _outliers),  # 3 to 6 sd
    "growing-noise": Form(2.0, "noise", _growing),  # a battery that runs low
    "bad-channels": Form(5.0, "noise", _few_columns),  # 3 to 10 times as loud, cold joints
    "noise-across-neighbours": Form(1.0, "noise", _across_neighbours),  # read one after another
    "noise-of-the-reading": Form(1e-3, "reading", _white),  # 60 dB, the source's own noise
    "common-flicker": Form(3e-4, "common", _flicker),
    "common-wander": Form(3e-4, "common", _centred(_in_seconds(5.0, 60.0))),
    "shared-wander": Form(3e-4, "channel", _centred(_shared(_in_seconds(5.0, 60.0)))),
    "lasting-drift": Form(3e-4, "channel", _centred(_in_frames(0.985, 0.995))),
    "levelling-drift": Form(3e-4, "channel", _centred(_levelling)),  # a board that warms up
    "lasting-gain": Form(5e-4, "gain", _in_frames(0.6, 0.95)),
    "flicker-gain": Form(5e-4, "gain", _flicker),
    "long-tailed-gain": Form(5e-4, "gain", _long_tailed),
    "gain-steps": Form(2e-3, "gain", _centred(_steps)),
    "gain-per-press": Form(1e-3, "gain", _between_presses),
    "gain-walk-in-frames": Form(2e-3, "gain", _centred(_walk)),
    "gain-wander-in-minutes": Form(2e-3, "gain", _centred(_in_seconds(20.0, 300.0))),
    "levelling-gain": Form(3e-3, "gain", _centred(_levelling)),  # 50 ppm/K, tens of K
    "gain-beat": Form(1e-3, "gain", _centred(_sine(2.5, 12.0))),  # of the mains with the frames
    "gain-saw": Form(2e-3, "gain", _centred(_saw(20.0, 120.0))),  # a heater goes on and off
    "bank-step": Form(2e-3, "bank", _centred(_one_step)),
    "bank-walks": Form(1e-3, "bank", _centred(_walk)),
    "place-creep": Form(0.3, "place", _within_press),  # of the probe's rubber
    "lasting-place": Form(0.3, "place", _in_frames(0.6, 0.95)),  # an arm that swings
    "place-walk": Form(0.3, "place", _centred(_over_presses)),  # slipping steps
    "levelling-place": Form(0.3, "place", _centred(_levelling)),  # arms grow by tenths of a mm
    "backlash": Form(0.3, "place", _each_press_either),  # to either side, of cheap gears
    "long-tailed-place": Form(0.3, "place", _each_press_long_tailed),
    "coarse-place": Form(0.33, "coarse-place"),  # logs in tenths of a mm, tables in whole ones
    "long-tailed-force": Form(0.05, "force", _long_tailed),
    "lasting-force": Form(0.05, "force", _in_frames(0.6, 0.95)),
    "force-zero-per-press": Form(0.1, "force", _each_press),  # tared before each, 1 % of 10 N
    "relaxing-force-zero": Form(0.1, "force", _relaxing),  # creep of the cell
    "force-gain-wander": Form(2e-2, "load-cell", _centred(_in_seconds(20.0, 300.0))),
    "levelling-force-gain": Form(2e-2, "load-cell", _centred(_levelling)),
    "coarse-force": Form(0.07, "coarse-force"),  # up to 0.2 N, of 8 bits
    "clock-jitter": Form(5e-3, "clock", _jitter),  # of an operating system
    "coarse-clock": Form(1.5e-2, "coarse-clock"),  # a tick of a PC's timer
}


def _lot(kind: str) -> str:
    return hashlib.sha256(f"{LOT} {kind}".encode()).hexdigest()


SEALED = tuple(sorted(sorted(FORMS, key=_lot)[: len(FORMS) // 3]))
OPEN = tuple(sorted(set(FORMS) - set(SEALED)))


@dataclass(frozen=True)
class AlienError(RigError):
    """A kind of error with its size, in the unit of FORMS, and the seed of its random numbers."""

    def rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, zlib.crc32(self.kind.encode())])

    @property
    def form(self) -> Form:
        """Its form."""
        return FORMS[self.kind]

    def course(self, line: Timeline, count: int) -> np.ndarray:
        """(N, count): the error in the unit of its form; of a kind that rounds none."""
        assert self.form.course is not None
        return self.size * self.form.course(self.rng(), line, count)


def draw(
    rng: np.random.Generator, kinds: Sequence[str] | None = None, sealed: bool = False
) -> list[AlienError]:
    """The errors of a rig: of `kinds`, or of one to three random ones, all of them open; or, with
    `sealed`, one of them sealed and the others any."""
    if kinds is None:
        number = int(rng.integers(1, MAX_KINDS + 1))
        first = str(rng.choice(SEALED if sealed else OPEN))
        others = [kind for kind in (sorted(FORMS) if sealed else OPEN) if kind != first]
        kinds = [first, *rng.choice(others, number - 1, replace=False).tolist()]
    return [
        AlienError(kind, drawn_size(rng, FORMS[kind].size), int(rng.integers(2**31)))
        for kind in kinds
    ]


def reported(states: pd.DataFrame, errors: Sequence[AlienError]) -> pd.DataFrame:
    """The states in the recording, from the true ones: x_mm, y_mm and force_N with errors where
    touched, time_s with errors from the first frame on. Forces are clipped at 0; what is coarse is
    rounded last."""
    reported_states = states.copy()
    touched = states["touch"].to_numpy(bool)
    line = timeline(states, touched)
    for error in sorted(errors, key=lambda error: error.form.course is None):
        on, size = error.form.on, error.size
        if on == "place":
            shift = np.where(touched[:, None], error.course(line, 2), 0.0)
            reported_states[["x_mm", "y_mm"]] += shift
        elif on == "force":
            reported_states["force_N"] += np.where(touched, error.course(line, 1)[:, 0], 0.0)
        elif on == "load-cell":
            reported_states["force_N"] *= 1.0 + np.where(touched, error.course(line, 1)[:, 0], 0.0)
        elif on == "clock":
            late_s = error.course(line, 1)[:, 0]
            reported_states["time_s"] += late_s - late_s[0]
        elif on.startswith("coarse-"):
            unit = error.form.usual.unit
            keys = [
                key for key in ("x_mm", "y_mm", "force_N", "time_s") if key.endswith(f"_{unit}")
            ]
            reported_states[keys] = size * np.round(reported_states[keys] / size)
    reported_states["force_N"] = reported_states["force_N"].clip(lower=0.0)
    return reported_states


def read(
    clean: np.ndarray,
    errors: Sequence[AlienError],
    states: pd.DataFrame,
    noise_V: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Noisy readings (N, M) V from noise-free ones (N, M) V.

    noise_V (M,): sd of the white noise, drawn with `rng`, beside which errors of noise are. Gains
    act on noise-free readings.
    """
    channels = clean.shape[1]
    median = float(np.median(np.abs(clean[0])))
    line = timeline(states, np.ones(len(states), bool))
    gain, added = np.ones_like(clean), noise_V * rng.standard_normal(clean.shape)
    for error in errors:
        on = error.form.on
        if on == "noise":
            added += noise_V * error.course(line, channels)
        elif on in ("channel", "common"):
            added += median * error.course(line, channels if on == "channel" else 1)
        elif on in ("reading", "gain"):
            gain *= 1.0 + error.course(line, channels if on == "reading" else 1)
        elif on == "bank":
            gain *= 1.0 + error.course(line, BANKS)[:, np.arange(channels) % BANKS]
    return gain * clean + added


def timeline(states: pd.DataFrame, acting: np.ndarray) -> Timeline:
    """The timeline of states, for an error that acts in some frames (N,)."""
    press = pd.factorize(states["contact"].to_numpy())[0]
    begun = np.maximum.accumulate(press) + 1
    return Timeline(states["time_s"].to_numpy(float), elapsed_share(states), press, begun, acting)
