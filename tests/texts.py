"""What findings say, for tests of their wording."""

from collections.abc import Iterable

from vergence.findings import Finding, Severity, select


def texts(findings: Iterable[Finding], *severities: Severity) -> list[str]:
    """Return the sentences of findings of some severities; none named: of void and warning."""
    return [each.sentence for each in select(findings, *(severities or ("void", "warning")))]
