"""Words of specimens: what they name, and that bad ones are refused with what is allowed."""

import math

import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import InputError, Specimen


def test_kinds_have_their_numbers_in_si() -> None:
    ball = Specimen.parse("ball=sphere:R_mm=20,E_MPa=0.3")
    assert (ball.name, ball.shape, ball.stiffness_n_m) == ("ball", "sphere", None)
    assert_allclose((ball.radius_m, ball.youngs_modulus_pa), (0.02, 0.3e6))
    assert Specimen.parse("ball=sphere:R_mm=20").youngs_modulus_pa == math.inf
    sheet = Specimen.parse("sheet=layer:h_mm=2,E_MPa=0.1")
    assert (sheet.shape, sheet.radius_m) == ("layer", math.inf)
    assert_allclose(sheet.thickness_m, 2e-3)
    slow = Specimen.parse("slow=viscous:E_MPa=0.1,tau2_s=3,E1_MPa=0.05,tau1_s=1,E2_MPa=0.02")
    assert slow.shape == "cylinder"
    assert_allclose(slow.branches, [(0.05e6, 1.0), (0.02e6, 3.0)])
    assert Specimen.parse("b=sphere:R_mm=20?") == Specimen.parse("b=sphere:R_mm=20")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("b=cone:R_mm=20", "specimen-kind"),
        ("b=sphere:E_MPa=1", "missing-parameter"),
        ("b=sphere:R_mm=-2", "number-range"),
        ("b=sphere:R_mm=nan", "number-range"),
        ("b=sphere:R_mm=inf", "number-range"),
        ("b=sphere:R_mm", "number-range"),
        ("b=sphere:R=20", "unknown-parameter"),
        ("b=sphere:R_mm=20,R_mm=30", "repeated-parameter"),
        ("b=sphere:R_mm=20,E1_MPa=1,tau1_s=1", "rigid-relaxes"),
        ("b=layer:h_mm=2", "missing-parameter"),
        ("b=layer:h_mm=2,E_MPa=0.1,R_mm=3", "unknown-parameter"),
        ("b=viscous:E_MPa=0.1", "viscous-needs-term"),
        ("b=viscous:E_MPa=0.1,E1_MPa=1,tau2_s=1", "relaxation-terms"),
        ("=sphere:R_mm=20", "specimen-syntax"),
        ("b=7x", "specimen-syntax"),
    ],
)
def test_bad_words_are_refused_with_what_is_allowed(words, says) -> None:
    with refused(says, InputError):
        Specimen.parse(words)
