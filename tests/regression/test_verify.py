"""Both discretisations on one case: they agree, and the command says how well."""

from pathlib import Path

from opticcup_fem.studies import verify
from tests.support.cups import coarse_case


def test_surface_and_meridian_agree(tmp_path: Path) -> None:
    """Through the first invagination, on a coarse surface mesh: within two per cent everywhere."""
    outcome = verify.run(coarse_case(), tmp_path, quiet=True)
    assert outcome.ok
    lines = [line.split() for line in outcome.message.splitlines()]
    changes = [float(words[-2]) for words in lines if words[-1] == "%"]
    assert len(changes) >= 8 and max(map(abs, changes)) < 2.0
    assert any(words[:2] == ["event", "primary_invagination"] for words in lines)
    assert (tmp_path / "verify.png").stat().st_size > 10_000
    assert (tmp_path / "surface" / "path.csv").exists()
