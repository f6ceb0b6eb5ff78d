"""What varies from draw to draw: `--vary NAME=SPEC`, the points of a campaign, its noise seeds.

    lo:hi                 uniform between lo and hi
    lo:hi:n               n values from lo to hi, both included, equally likely
    choice(a,b,c)         these values, equally likely
    normal(m,s)           mean m, standard deviation s
    normal(m,s,lo,hi)     the same, truncated to lo..hi
    lognormal(m,f)        median m > 0; one standard deviation is a factor of f > 1: 68 % of the
                          values lie within m/f..m f (ln value: mean ln m, deviation ln f)
    x0.5:2, xnormal(1,0.1), xlognormal(1,1.3), xchoice(1,2), x0.5:2:n
                          the same, as a factor on the rig's own value

Numbers are written as in YAML. A draw is a point in the open unit cube, one coordinate a
variation; a coordinate becomes a value by the inverse of its distribution. Every process of a
campaign makes the same points from (variations, sampling, seed), and every shard takes its own.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.rig import yamlfile
from pcpc.tools.study.arrays import Vector

SAMPLINGS = ("random", "lhs", "sobol", "grid")
KINDS = {"choice": (1, math.inf), "normal": (2, 4), "lognormal": (2, 2)}  # how many numbers
SOBOL_BITS = 32  # more points than any campaign has; half a step from 0 is a float64
SEED_BITS = 31
LEAST, MOST = 2.0**-54, 1.0 - 2.0**-53  # of a coordinate: 0 and 1 have no value
_CALL = re.compile(r"([a-z]+)\((.*)\)", re.DOTALL)
_FORMS = "lo:hi, lo:hi:n, normal(m,s), lognormal(median,factor), choice(a,b,...), or x before one"


@dataclass(frozen=True)
class Variation:
    """A varied value: `kind` is uniform, grid, choice, normal or lognormal; `text` is the option's.

    `numbers` are those of the option; `relative`: they are factors on the rig's own value.
    """

    name: str
    text: str
    kind: str
    numbers: tuple[float, ...]
    relative: bool = False

    @property
    def levels(self) -> int | None:
        """How many values there are; None of a continuous distribution."""
        if self.kind == "choice":
            return len(self.numbers)
        return int(self.numbers[2]) if self.kind == "grid" else None

    def value(self, u: float, own: float) -> float:
        """Return the value at `u` in (0, 1), the share of lower values; `own` is the rig's value.

        Of `choice`, u goes along the values as they are written. RigError where the own value is 0
        and the variation a factor.
        """
        if self.relative and own == 0.0:
            raise self.error("the rig's own value is 0, which a factor does not vary; give lo:hi")
        return self._value_at(u) * own if self.relative else self._value_at(u)

    def _value_at(self, u: float) -> float:
        a, *more = self.numbers
        if self.kind == "choice":
            return self.numbers[int(u * len(self.numbers))]
        if self.kind == "uniform":
            return a + u * (more[0] - a)
        if self.kind == "grid":
            n = int(more[1])
            return a + int(u * n) / (n - 1) * (more[0] - a)
        from scipy.special import ndtr, ndtri

        if self.kind == "lognormal":
            return a * more[0] ** float(ndtri(u))
        if more[1:]:  # truncated: in the tail that has the digits
            low, high = ((bound - a) / more[0] for bound in more[1:])
            sign = -1.0 if low > 0.0 else 1.0
            shares = ndtr(sign * low), ndtr(sign * high)
            z = sign * float(ndtri(shares[0] + u * (shares[1] - shares[0])))
            return a + more[0] * min(max(z, low), high)
        return a + more[0] * float(ndtri(u))

    def error(self, what: str) -> RigError:
        """Return the error with the option before it."""
        return RigError(f"--vary {self.name}={self.text}: {what}")


def parse(option: str) -> Variation:
    """Return what `NAME=SPEC` says. Raises RigError, one line with the cure."""
    name, equals, text = (part.strip() for part in option.partition("="))
    if not (name and equals and text):
        raise RigError(f"--vary {option}: expected NAME=SPEC, such as plant.friction_Nm=x0.5:2")
    relative = text.startswith("x")  # no distribution's own name begins with one
    bare = text[1:] if relative else text
    call = _CALL.fullmatch(bare)
    blank = Variation(name, text, call[1] if call else "uniform", (), relative)
    words = call[2].split(",") if call else bare.split(":")
    if call and call[1] not in KINDS:
        raise blank.error(f"unknown distribution {call[1]}{did_you_mean(call[1], KINDS)}")
    if not call and len(words) not in (2, 3):
        raise blank.error(f"expected {_FORMS}")
    numbers = tuple(_number(blank, word.strip()) for word in words)
    kind = "grid" if not call and len(words) == 3 else blank.kind
    found = Variation(name, text, kind, numbers, relative)
    if what := _wrong(kind, numbers):
        raise found.error(what)
    return found


def _number(variation: Variation, word: str) -> float:
    try:
        number = yamlfile.parse_scalar(word)
    except ValueError as error:
        raise variation.error(str(error)) from None
    if type(number) not in (int, float) or not math.isfinite(number):
        what = f"{word!r} is not a finite number" if word else "a number is missing"
        raise variation.error(f"{what}; expected {_FORMS}")
    return float(number)


def _wrong(kind: str, numbers: tuple[float, ...]) -> str:
    """Return what is wrong with the numbers of a distribution and its cure, or ''."""
    fewest, most = KINDS.get(kind, (2, 3))
    if not fewest <= len(numbers) <= most or (kind == "normal" and len(numbers) == 3):
        return f"{len(numbers)} numbers; expected {_FORMS}; truncated: normal(m,s,lo,hi)"
    if kind in ("uniform", "grid") and not numbers[0] < numbers[1]:
        return f"{numbers[0]:g} is not below {numbers[1]:g}; write the lower bound first"
    if kind == "grid" and not (numbers[2] >= 2 and numbers[2] == int(numbers[2])):
        return f"{numbers[2]:g} values; expected a whole number of 2 or more"
    if kind == "choice" and len(set(numbers)) < len(numbers):
        return "a value is there twice; give each once"
    if kind == "normal" and not numbers[1] > 0.0:
        return f"standard deviation {numbers[1]:g}; expected more than 0"
    if kind == "normal" and len(numbers) == 4 and not numbers[2] < numbers[3]:
        return f"{numbers[2]:g} is not below {numbers[3]:g}; write the lower bound first"
    if kind == "lognormal" and not (numbers[0] > 0.0 and numbers[1] > 1.0):
        return "expected median > 0 and factor > 1, as lognormal(2,1.3) for 2/1.3..2*1.3 in 68 %"
    return ""


def parse_variations(options: Sequence[str]) -> tuple[Variation, ...]:
    """Return the variations of a campaign. Raises RigError where a name stands twice."""
    found = tuple(parse(option) for option in options)
    for i, variation in enumerate(found):
        if variation.name in {other.name for other in found[:i]}:
            raise variation.error("this value is already varied; give one --vary for a name")
    return found


def values(variations: Sequence[Variation], points: Vector, own: Sequence[float]) -> Vector:
    """Return the values of points (n, d), of the same shape; `own`: the rig's own d values."""
    columns = zip(variations, points.T, own, strict=True)
    found = [[v.value(float(u), value) for u in column] for v, column, value in columns]
    return np.array(found, dtype=np.float64).reshape(len(found), -1).T


def snap_to_levels(variations: Sequence[Variation], points: Vector) -> Vector:
    """Return points (n, d) in which all coordinates with the same value are the same number."""
    found = np.array(points)
    for column, levels in zip(found.T, (v.levels for v in variations), strict=True):
        if levels:
            column[:] = (np.floor(column * levels) + 0.5) / levels
    return found


def points_of_normal(z: Vector) -> Vector:
    """Return the points (n, d) of standard normal coordinates, as `rare.subset` asks for them."""
    from scipy.special import ndtr

    return np.clip(ndtr(z), LEAST, MOST)


def grid_size(variations: Sequence[Variation]) -> int:
    """Return how many points the full grid has. RigError where a variation has no levels."""
    for variation in variations:
        if variation.levels is None:
            raise variation.error("a grid needs values; give lo:hi:n or choice(...)")
    return math.prod(variation.levels or 1 for variation in variations)


def points(variations: Sequence[Variation], n: int, sampling: str, seed: int) -> Vector:
    """Return the draws of a campaign, (n, d) in the open unit cube; the last varies fastest.

    `random` and `sobol` (scrambled): point i is the same for every n, so that a campaign can be
    continued. `lhs`: n is part of the design, and another n has other points. `grid`: all
    combinations of all levels; n has to be their number. The same numbers come from the same
    versions of numpy and scipy; the table of a campaign holds the values themselves.
    RigError: no such sampling, or a wrong number.
    """
    d = len(variations)
    if n < 1:
        raise RigError(f"{n} draws; expected 1 or more")
    if sampling == "grid":
        if n != (size := grid_size(variations)):
            raise RigError(f"{n} draws; this grid has {size} combinations, give no number of draws")
        axes = [(np.arange(v.levels or 1) + 0.5) / (v.levels or 1) for v in variations]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(n, d)
    if sampling == "random":
        return np.clip(np.random.default_rng(seed).random((n, d)), LEAST, MOST)
    from scipy.stats import qmc

    if sampling == "lhs":
        found = qmc.LatinHypercube(d, rng=np.random.default_rng(seed)).random(n)
        return np.clip(found, LEAST, MOST)
    if sampling == "sobol":
        if d > qmc.Sobol.MAXDIM:
            raise RigError(f"{d} variations; sobol takes {qmc.Sobol.MAXDIM}, choose random")
        engine = qmc.Sobol(d, bits=SOBOL_BITS, rng=np.random.default_rng(seed))
        whole = engine.random_base2((n - 1).bit_length())  # a power of 2: of others scipy warns
        return whole[:n] + 2.0 ** -(SOBOL_BITS + 1)  # from k/2^32 to the middle of its step
    raise RigError(f"sampling {sampling}: unknown{did_you_mean(sampling, SAMPLINGS)}")


def run_seed(campaign_seed: int, draw: int) -> int:
    """Return the noise seed of a draw, 1..2^31 - 1: the same for all controllers, so they pair.

    No two draws of a campaign share one: each step is a permutation of the numbers of 31 bits, and
    what would be 0 goes round again, which keeps a permutation of the others one. ValueError
    outside 0..2^31 - 2.
    """
    top = 2**SEED_BITS - 1
    if not 0 <= draw < top:
        raise ValueError(f"draw {draw} is not within 0..{top - 1}")
    key = np.random.SeedSequence(campaign_seed).generate_state(4).tolist()
    seed = draw + 1
    while True:
        for word in key:
            seed = (seed * (word | 1) + (word >> 3)) & top
            seed ^= seed >> 15
        if seed:
            return seed
