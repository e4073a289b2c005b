"""What a model cannot be held against is refused in words."""

import msgspec
import pytest

from groundstation.comparison.comparison import compare
from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.errors import BadInputError
from support.flights import BASE
from support.flights import compared as flights


def test_a_model_that_grows_without_end_is_refused():
    endless = EffectTerm(
        "quadratic_rate_damping", {"damping_n_m_s2": Estimate(-1.0, None, "N m s^2")}
    )
    model = msgspec.structs.replace(BASE, effects=(endless,))
    with pytest.raises(BadInputError, match=r"predicts no number there.*motor constants"):
        compare(flights(1), model)
