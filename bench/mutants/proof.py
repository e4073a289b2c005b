"""What makes a figure honest: intervals, gates, rows that no fit has seen."""

from bench.mutants.fault import Fault

_ESTIMATE = "groundstation/identification/estimate.py"
_ESTIMATES = "tests/identification/test_estimate.py"
_DIVISION = "groundstation/identification/division.py"
_DIVISIONS = "tests/identification/test_division.py"
_JUDGED = "groundstation/discrepancy/division.py"
_JUDGED_TESTS = "tests/discrepancy/test_division.py"
_ENGINE = "groundstation/discrepancy/engine.py"
_PROVEN = "tests/discrepancy/test_proof.py"
_PROOF_ALONE = f"{_PROVEN}::test_nothing_of_the_recordings_of_the_proof_is_fitted_or_decides"
_GATES = "groundstation/discrepancy/acceptance.py"
_GATE_TESTS = "tests/discrepancy/test_acceptance.py"

FAULTS = (
    Fault(
        "small-standard-errors",
        "standard errors are 30 % too small",
        _ESTIMATE,
        "return np.sqrt(np.diag(self.covariance))",
        "return 0.7 * np.sqrt(np.diag(self.covariance))",
        (_ESTIMATES,),
        least=2,
    ),
    Fault(
        "small-sandwich",
        "errors that are correlated in time count as half of what they are",
        _ESTIMATE,
        "meat = scores.T @ scores * (blocks / max(blocks - count, 1))",
        "meat = scores.T @ scores * 0.5",
        (_ESTIMATES,),
        least=2,
    ),
    Fault(
        "narrow-intervals",
        "95 % intervals hold the truth in 90 % of cases",
        _ESTIMATE,
        "t.ppf(0.5 + 0.5 * probability, self.degrees_of_freedom)",
        "t.ppf(probability, self.degrees_of_freedom)",
        (_ESTIMATES,),
        least=2,
    ),
    Fault(
        "small-errors-of-arx",
        "standard errors of polynomials are 30 % too small",
        "groundstation/identification/arx/fit.py",
        "variance = left / max(rows - len(chosen), 1)",
        "variance = 0.5 * left / max(rows - len(chosen), 1)",
        (
            "tests/identification/arx/test_fit.py::test_one_gram_matrix_gives_the_least_squares_of_every_structure",
        ),
    ),
    Fault(
        "held-out-rows-fitted",
        "rows that judge the fit are fitted",
        _DIVISION,
        "                fitted.append((at, a))",
        "                fitted.append((at, b))",
        (f"{_DIVISIONS}::test_every_row_is_fitted_or_held_out_once",),
    ),
    Fault(
        "last-third-fitted",
        "the fit sees the whole run of which the last third judges it",
        _DIVISION,
        "        fit_on += [run[a:b] for a, b in fitted]\n",
        "        fit_on += [run for _ in fitted]\n",
        (f"{_DIVISIONS}::test_the_last_third_of_several_runs_cuts_one_of_them",),
    ),
    Fault(
        "search-sees-the-proof",
        "a search fits the rows that prove it",
        _JUDGED,
        "fit_on += [one.run[a:b] for a, b in one.with_ground(fitted)]",
        "fit_on += [one.run for a, b in one.with_ground(fitted)]",
        (f"{_JUDGED_TESTS}::test_the_last_third_is_held_out_where_it_serves",),
    ),
    Fault(
        "short-flight-fitted-whole",
        "a short flight is fitted and judged on the same rows",
        _JUDGED,
        "return Division([*fit_on, run[:edge]], [run[edge:]]",
        "return Division([*fit_on, run], [run[edge:]]",
        (
            f"{_JUDGED_TESTS}::test_of_one_flight_that_is_no_three_pieces_long_the_last_seconds_are_held_out",
        ),
    ),
    Fault(
        "given-proof-fitted",
        "recordings of --validate are fitted",
        _JUDGED,
        'return _given(every, [run for part in held for run in part], "")',
        'return _given([*every, *held[0]], [run for part in held for run in part], "")',
        (f"{_JUDGED_TESTS}::test_given_recordings_are_held_out_as_they_are", _PROOF_ALONE),
        least=2,
    ),
    Fault(
        "search-is-given-the-proof",
        "a search takes names and sizes from the recordings of --validate, too",
        _ENGINE,
        "find_effects(\n        parts.fit_on,",
        "find_effects(\n        [*parts.fit_on, *parts.held_out],",
        (_PROOF_ALONE,),
    ),
    Fault(
        "proof-decides",
        "recordings of --validate decide what they prove: what predicts them worse is taken back",
        _ENGINE,
        "judged=FittedRows(train.before, EVERY_S)",
        "judged=FittedRows(proof_rows.before, EVERY_S)",
        (_PROOF_ALONE,),
    ),
    Fault(
        "disturbance-of-the-proof",
        "the improved model's disturbance is that of the recordings of --validate",
        _ENGINE,
        "with_disturbance(findings.model, train.of(findings.model))",
        "with_disturbance(findings.model, proof_rows.of(findings.model))",
        (_PROOF_ALONE,),
    ),
    Fault(
        "noise-of-the-proof",
        "noise is learnt on the recordings of --validate, which are judged by it",
        _ENGINE,
        "compare(parts.judged, model, black_box)",
        "compare(parts.judged, model)",
        (_PROOF_ALONE,),
    ),
    Fault(
        "left-out-flight-fitted",
        "a flight that is left out is asked with a size that was taken from it, too",
        "groundstation/discrepancy/evidence.py",
        "inverse(whole.normal - one.normal) @ (whole.gradient - one.gradient)",
        "inverse(whole.normal) @ whole.gradient",
        (
            "tests/discrepancy/test_evidence.py::test_a_flight_is_asked_with_the_size_that_the_others_say",
        ),
    ),
    Fault(
        "gate-of-significance",
        "what chance can do has a name",
        _GATES,
        "enough = evidence.drop >= least and evidence.t >= LEAST_T",
        "enough = evidence.drop >= least or evidence.t >= LEAST_T",
        (f"{_GATE_TESTS}::test_evidence_has_to_be_plausible_strong_and_hold_on_other_rows",),
    ),
    Fault(
        "gate-of-held-out-rows",
        "a name is believed that predicts nothing new",
        _GATES,
        "enough = evidence.held_out >= max(LEAST_HELD_OUT, HELD_OUT_SHARE * evidence.expected)",
        "enough = True",
        (f"{_GATE_TESTS}::test_evidence_has_to_be_plausible_strong_and_hold_on_other_rows",),
    ),
    Fault(
        "gate-of-plausible-sizes",
        "a size that no craft has is believed",
        _GATES,
        "if not ends and plausible(trial.variant, point):",
        "if not ends:",
        (f"{_GATE_TESTS}::test_evidence_has_to_be_plausible_strong_and_hold_on_other_rows",),
    ),
    Fault(
        "gate-of-the-superfluous",
        "an effect stays that the others explain as well",
        _GATES,
        'return "superfluous once another effect had joined" if trial.removal < KEEP else ""',
        'return ""',
        (f"{_GATE_TESTS}::test_what_the_others_do_as_well_without_leaves",),
    ),
    Fault(
        "gap-of-the-mean",
        "one channel that is predicted badly does not show in the gap",
        "groundstation/comparison/gap.py",
        "return float(np.sqrt(np.mean(ratio[known] ** 2))) if known.any()",
        "return float(np.min(ratio[known])) if known.any()",
        (
            "tests/comparison/test_gap.py::test_all_channels_in_one_number_leave_out_what_is_not_there",
        ),
    ),
)
