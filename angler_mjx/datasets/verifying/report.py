"""What was looked at in a dataset, and what was found wrong."""

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Finding:
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
class Check:
    """One kind of check."""

    name: str
    looked_at: str = ""
    """How much was, in words."""
    findings: list[Finding] = field(default_factory=list)

    def wrong(self, where: str, text: str) -> None:
        """Note something that is wrong."""
        self.findings.append(Finding(what=self.name, where=where, text=text))


@dataclass(frozen=True, kw_only=True)
class Report:
    """All checks of a dataset."""

    dataset: str
    checks: tuple[Check, ...]

    @property
    def agrees(self) -> bool:
        """Whether nothing was found."""
        return not any(check.findings for check in self.checks)

    @property
    def findings(self) -> list[Finding]:
        """Of all checks, in their order."""
        return [one for check in self.checks for one in check.findings]

    def table(self) -> dict[str, Any]:
        """In plain values."""
        return {
            "dataset": self.dataset,
            "agrees": self.agrees,
            "checks": {check.name: check.looked_at for check in self.checks},
            "findings": [asdict(one) for one in self.findings],
        }
