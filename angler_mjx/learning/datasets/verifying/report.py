"""Checks of a dataset and their findings."""

from dataclasses import asdict, dataclass, field


@dataclass(frozen=True, kw_only=True)
class DatasetFinding:
    """Fault of a dataset."""

    what: str
    """Check that found it."""
    where: str
    """File or array, below the dataset's folder."""
    text: str
    """Fault and remedy."""

    def line(self) -> str:
        """Return a line for a terminal."""
        return f"{self.what}: {self.where}: {self.text}"


@dataclass(kw_only=True)
class DatasetCheck:
    """Result of one kind of check."""

    name: str
    looked_at: str = ""
    """Amount of checked data, in words."""
    exact: int = 0
    """Number of files, parts, rows or episodes that were compared exactly."""
    bounded: int = 0
    """Number of samples or episodes that were compared with bounds."""
    unchecked: int = 0
    """Number of unchecked ones of the same kind."""
    why: str = ""
    """Reason for bounds or for unchecked data."""
    findings: list[DatasetFinding] = field(default_factory=list)

    def add_finding(self, where: str, text: str) -> None:
        """Add a finding."""
        self.findings.append(DatasetFinding(what=self.name, where=where, text=text))

    def line(self) -> str:
        """Return a line with amounts and faults, for a terminal."""
        if not self.exact and not self.bounded:
            return f"{self.name}: {self.looked_at}"
        why = f" ({self.why})" if self.why else ""
        return f"{self.name}: {self.looked_at}: {len(self.findings) or 'nothing'} wrong{why}"

    def table(self) -> dict[str, object]:
        """Return everything but the findings, for JSON."""
        return {
            key: value for key, value in asdict(self).items() if key not in ("name", "findings")
        }


@dataclass(frozen=True, kw_only=True)
class VerificationReport:
    """Checks of a dataset."""

    dataset: str
    checks: tuple[DatasetCheck, ...]

    @property
    def agrees(self) -> bool:
        """Return whether nothing was found."""
        return not any(check.findings for check in self.checks)

    @property
    def findings(self) -> list[DatasetFinding]:
        """Return the findings of all checks, in their order."""
        return [finding for check in self.checks for finding in check.findings]

    def table(self) -> dict[str, object]:
        """Return the report in plain values."""
        return {
            "dataset": self.dataset,
            "agrees": self.agrees,
            "checks": {check.name: check.table() for check in self.checks},
            "findings": [asdict(finding) for finding in self.findings],
        }
