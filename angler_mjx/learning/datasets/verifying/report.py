"""What was looked at in a dataset, and what was found wrong."""

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class DatasetFinding:
    """Something that is wrong."""

    what: str
    """Which check found it."""
    where: str
    """File or array, below the dataset's folder."""
    text: str
    """What is wrong, and what to do."""

    def line(self) -> str:
        """For a terminal."""
        return f"{self.what}: {self.where}: {self.text}"


@dataclass(kw_only=True)
class DatasetCheck:
    """One kind of check."""

    name: str
    looked_at: str = ""
    """How much was, in words."""
    exact: int = 0
    """Files, parts, rows or episodes that were compared exactly."""
    bounded: int = 0
    """Samples or episodes that were held against bounds."""
    unchecked: int = 0
    """Of the same kind, not looked at."""
    why: str = ""
    """Why some were only bounded, or not looked at."""
    findings: list[DatasetFinding] = field(default_factory=list)

    def add_finding(self, where: str, text: str) -> None:
        """Note something that is wrong."""
        self.findings.append(DatasetFinding(what=self.name, where=where, text=text))

    def line(self) -> str:
        """Return how much was checked and what was wrong, for a terminal."""
        if not self.exact and not self.bounded:
            return f"{self.name}: {self.looked_at}"
        why = f" ({self.why})" if self.why else ""
        return f"{self.name}: {self.looked_at}: {len(self.findings) or 'nothing'} wrong{why}"

    def table(self) -> dict[str, Any]:
        """Return all of it but the findings, for JSON."""
        return {
            key: value for key, value in asdict(self).items() if key not in ("name", "findings")
        }


@dataclass(frozen=True, kw_only=True)
class VerificationReport:
    """All checks of a dataset."""

    dataset: str
    checks: tuple[DatasetCheck, ...]

    @property
    def agrees(self) -> bool:
        """Whether nothing was found."""
        return not any(check.findings for check in self.checks)

    @property
    def findings(self) -> list[DatasetFinding]:
        """Of all checks, in their order."""
        return [finding for check in self.checks for finding in check.findings]

    def table(self) -> dict[str, Any]:
        """In plain values."""
        return {
            "dataset": self.dataset,
            "agrees": self.agrees,
            "checks": {check.name: check.table() for check in self.checks},
            "findings": [asdict(finding) for finding in self.findings],
        }
