"""The sequential part: which sizes are decided, what is flown next, and what the answer is.

Size n meets the deadline with probability p(n). The answer n* is the smallest number of robots with
p(n) >= P. A size is *accepted* when the lower end of its interval is P or more, and *excluded* when
the upper end is below P; the intervals hold at all times (`bernoulli`). With confidence 1 - alpha
the answer lies in

    [one robot more than the largest size up to which all are excluded, smallest accepted size]:

- too high would be a size below n* that was accepted though p < P. Each of the K sizes may err so
  with alpha / (2 K), all together with alpha / 2 (Bonferroni);
- too low would be n* itself excluded though p(n*) >= P. That is one size, whichever it is, and one
  upper end: alpha / 2.

Nothing is asked of p but that worlds are independent; it may fall again as robots meet each other.
Not all sizes are flown, of a list as of a span: a size between two excluded ones counts as excluded
too, and so does each size below the smallest of the file once that one is excluded. That is the
only assumption. Sizes that were not flown and lie beside one that is not excluded stay in the
interval.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from angler_mjx.studies.fleet_size import bernoulli

PATIENCE = 4
"""A size beside the estimate is given this part of its worlds before one farther off is tried."""

type Counts = Mapping[int, tuple[int, int]]
"""By position of a size: worlds that met the deadline, and worlds."""


@dataclass(frozen=True, kw_only=True)
class SequentialRule:
    """What is asked, and how much may be flown for it."""

    sizes: tuple[int, ...]
    first: tuple[int, ...]
    """Positions that are flown whatever the answer is; the first size's among them."""
    probability: float
    confidence: float
    within: int
    max_worlds: int
    """Of one size: no batch begins once so many were flown."""
    min_size: int = 1
    """Least number of robots that can do the task at all."""

    @property
    def is_list(self) -> bool:
        """Whether sizes between the first and the last are not in the file, or only one is."""
        return len(self.sizes) == 1 or len(self.sizes) <= self.sizes[-1] - self.sizes[0]

    def ends(self, hits: int, total: int) -> tuple[float, float]:
        """The interval of a size that decides about it."""
        if total == 0:
            return 0.0, 1.0
        return (
            bernoulli.lower_bound(hits, total, self._half / len(self.sizes), self.probability),
            bernoulli.upper_bound(hits, total, self._half, self.probability),
        )

    def verdict(self, hits: int, total: int) -> int:
        """1: the size is accepted; -1: it is excluded; 0: it is open. As `ends` has it."""
        p = self.probability
        if total == 0 or hits == p * total:
            return 0
        enough = hits > p * total
        alpha = self._half / len(self.sizes) if enough else self._half
        if bernoulli.log_ratio(p, hits, total, p) < -math.log(alpha):
            return 0
        return 1 if enough else -1

    @property
    def _half(self) -> float:
        """Probability of an error of either kind."""
        return 0.5 * (1.0 - self.confidence)


@dataclass(frozen=True, kw_only=True)
class SizeStatus:
    """What is known of a condition."""

    excluded: int
    """Last position up to which all sizes are excluded; -1 if none."""
    accepted: int
    """First position that is accepted; the number of sizes if none."""
    below: int
    """Last flown position before the estimate; -1 if none."""
    estimate: int
    """First flown position whose share is P or more; the number of sizes if none."""

    def good(self, rule: SequentialRule) -> bool:
        """Whether the interval is as short as it is to be, or holds no size of the file."""
        last = len(rule.sizes) - 1
        short = self.accepted - self.excluded - 1 <= 2 * rule.within and self.accepted <= last
        return short or self.excluded == last


def compute_status(rule: SequentialRule, counts: Counts) -> SizeStatus:
    """What counts tell."""
    flown = sorted(at for at, (_, total) in counts.items() if total > 0)
    verdicts = {at: rule.verdict(*counts[at]) for at in flown}
    excluded = -1
    for at in flown:
        if verdicts[at] != -1:
            break
        excluded = at
    none = len(rule.sizes)
    accepted = next((at for at in flown if verdicts[at] == 1), none)
    enough = [at for at in flown if counts[at][0] >= rule.probability * counts[at][1]]
    estimate = enough[0] if enough else none
    below = max((at for at in flown if at < estimate), default=-1)
    return SizeStatus(excluded=excluded, accepted=accepted, below=below, estimate=estimate)


def lower_target(rule: SequentialRule, status: SizeStatus) -> int:
    """Position up to which all sizes have to be excluded."""
    if status.estimate == len(rule.sizes):  # that none is enough has to be shown of the last one
        return status.estimate - 1
    return status.estimate - rule.within - 1


def upper_target(rule: SequentialRule, status: SizeStatus) -> int:
    """Position by which a size has to be accepted."""
    return status.estimate + rule.within if status.estimate < len(rule.sizes) else status.estimate


def select_next_sizes(rule: SequentialRule, counts: Counts) -> list[int]:
    """Positions of the sizes of which the next batch is to be flown, in order; none at the end."""
    lacking = [at for at in rule.first if _count_worlds(counts, at) == 0]
    if lacking:
        return lacking
    status = compute_status(rule, counts)
    none = status.estimate == len(rule.sizes)
    between = _beside_best(rule, counts) if none else []
    if between or status.good(rule):
        return between
    if not none and status.estimate - status.below > rule.within + 1:
        unsure = [at for at in (status.below, status.estimate) if _is_unsure(rule, counts, at)]
        return unsure or [(status.below + status.estimate) // 2]
    requested = [*_sizes_to_exclude(rule, counts, status), *_sizes_to_accept(rule, counts, status)]
    return sorted(dict.fromkeys(requested))


def _is_unsure(rule: SequentialRule, counts: Counts, at: int) -> bool:
    """Whether a share is within two standard errors of P, and few worlds were flown for it.

    A few batches more cost less than another size between two that may be on the same side.
    """
    hits, total = counts.get(at, (0, 0))
    p = rule.probability
    near = (hits - p * total) ** 2 < 4.0 * p * (1.0 - p) * total
    return near and total * PATIENCE**2 < rule.max_worlds


def _beside_best(rule: SequentialRule, counts: Counts) -> list[int]:
    """Middles of the gaps beside the best size, where none was good enough.

    Success that falls with more robots may have passed between two sizes that were flown. Empty
    where the largest may be as good as the best, or no gap is left.
    """
    rates = {at: hits / total for at, (hits, total) in counts.items()}
    best, last = max(sorted(rates), key=lambda at: rates[at]), len(rule.sizes) - 1
    if best == last or rule.ends(*counts[best])[0] <= rates[last]:
        return []
    before = max((at for at in counts if at < best), default=best)
    after = min(at for at in counts if at > best)
    gaps = ((before, best), (best, after))
    return [(a + b) // 2 for a, b in gaps if b - a > rule.within + 1]


def _sizes_to_exclude(rule: SequentialRule, counts: Counts, status: SizeStatus) -> list[int]:
    """What is to be flown so that the lower end rises."""
    target = lower_target(rule, status)
    if status.excluded >= target:
        return []
    if status.estimate == len(rule.sizes):  # all that were flown have to be
        return [at for at in counts if at > status.excluded and _is_open(rule, counts, at)]
    near = [at for at in range(status.below, target, -1) if at > status.excluded]
    chosen = _choose_size(rule, counts, near, target, -1, status.excluded)
    if chosen is None:
        return []
    # Those below it that were flown and are not excluded stand in its way.
    before = [at for at in counts if status.excluded < at < chosen and _is_open(rule, counts, at)]
    return [*before, chosen]


def _sizes_to_accept(rule: SequentialRule, counts: Counts, status: SizeStatus) -> list[int]:
    """What is to be flown so that the upper end falls."""
    target = min(upper_target(rule, status), len(rule.sizes) - 1)
    if status.accepted <= target:
        return []
    near = list(range(status.estimate, target))
    chosen = _choose_size(rule, counts, near, target, 1, status.accepted)
    return [] if chosen is None else [chosen]


def _choose_size(
    rule: SequentialRule, counts: Counts, near: Sequence[int], target: int, step: int, stop: int
) -> int | None:
    """The size that is to decide: beside the estimate, at the target, or farther off.

    Args:
        rule: of the study.
        counts: so far.
        near: positions before the target, those beside the estimate first.
        target: position that would be good enough.
        step: -1 down, 1 up.
        stop: position that is decided already; nothing is gained from there on.
    """
    for at in near:
        few = 0 < _count_worlds(counts, at) * PATIENCE < rule.max_worlds
        if few and _is_open(rule, counts, at):
            return at
    away = 0
    while (target + step * away - stop) * step < 0 and 0 <= target + step * away < len(rule.sizes):
        if _is_open(rule, counts, target + step * away):
            return target + step * away
        away = max(1, 2 * away)
    return next((at for at in near if _is_open(rule, counts, at)), None)


def _count_worlds(counts: Counts, at: int) -> int:
    return counts.get(at, (0, 0))[1]


def _is_open(rule: SequentialRule, counts: Counts, at: int) -> bool:
    """Whether more worlds may be flown of a size that is not decided."""
    hits, total = counts.get(at, (0, 0))
    return total < rule.max_worlds and rule.verdict(hits, total) == 0


@dataclass(frozen=True, kw_only=True)
class SizeAnswer:
    """The answer for one condition, as far as it is known."""

    estimate: int | None
    """The smallest size that was flown and met the deadline often enough; None if none did."""
    low: int | None
    """Least size that the answer can be; None: it is more than the largest."""
    high: int | None
    """Greatest; None: it may be more than the largest."""
    good: bool
    """Whether the interval is as short as it is to be."""
    worlds: int
    """That were flown for it."""
    largest: int
    """Size of the file."""
    listed: tuple[int, ...]
    """Sizes of the file where they are a list with gaps; else none."""

    def text(self, confidence: float) -> str:
        """In words."""
        level_text = f"{100 * confidence:g} %"
        if self.low is None:
            return f"more than {self.largest} robots ({level_text})"
        if self.high is None:
            interval = f"{self.low} or more"
        elif self.low == self.high:
            interval = f"{self.low}"
        else:
            interval = f"between {self.low} and {self.high}"
        if self.good:
            plural = "" if self.estimate == 1 else "s"
            return f"{self.estimate} robot{plural}{self._of_listed()} ({level_text}: {interval})"
        return f"open: {interval} ({level_text}) after {self.worlds:,} worlds"

    def _of_listed(self) -> str:
        """The sizes that the estimate was chosen from, in words."""
        if not self.listed:
            return ""
        *others, last = map(str, self.listed)
        return f", of {', '.join(others)} and {last}" if others else ", the only size of the file"


def build_answer(rule: SequentialRule, counts: Counts) -> SizeAnswer:
    """What counts tell of the answer."""
    status, none = compute_status(rule, counts), len(rule.sizes)
    return SizeAnswer(
        estimate=None if status.estimate == none else rule.sizes[status.estimate],
        low=None if status.excluded == none - 1 else _lowest_size(rule, status),
        high=None if status.accepted == none else rule.sizes[status.accepted],
        good=status.good(rule),
        worlds=sum(total for _, total in counts.values()),
        largest=rule.sizes[-1],
        listed=rule.sizes if rule.is_list else (),
    )


def _lowest_size(rule: SequentialRule, status: SizeStatus) -> int:
    """Least number of robots that is not excluded, whether it was flown or not."""
    return rule.min_size if status.excluded < 0 else rule.sizes[status.excluded] + 1
