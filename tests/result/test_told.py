"""What a result says on the console."""

from __future__ import annotations

from typing import Any

from hydrabeam_mpi.result.told import say_result

CHANNEL = {
    "freq_hz": 131e6, "train_chi2": 0.997, "heldout_rms_jy": 0.01312, "heldout_rms_jy_noise": 0.013,
    "heldout_rms_jy_unperturbed": 1.234, "heldout_chi2_predictive": 1.012,
}  # fmt: skip
LINE = (
    "131 MHz: held-out rms 0.0131 Jy (noise 0.013, model beam 1.23 Jy), reduced chi^2 1.01 under the posterior "
    "predictive (1 where it is calibrated)"
)


def of(**changes: Any) -> dict[str, Any]:
    return {**CHANNEL, **changes}


def test_each_of_a_few_channels_has_a_line() -> None:
    assert say_result({"channels": [of(), of(freq_hz=132.5e6)]}) == [LINE, LINE.replace("131 MHz", "132.5 MHz")]


def test_of_many_channels_the_worst_has() -> None:
    channels = [of(freq_hz=130e6 + 1e6 * i, heldout_chi2_predictive=1.0 if i != 1 else 1.012) for i in range(9)]
    assert say_result({"channels": channels}) == [f"of 9 channels the one that is predicted worst, {LINE}"]


def test_without_held_out_data_the_fitted_ones_are_told() -> None:
    alone = {"freq_hz": 131e6, "train_chi2": 0.997}
    expected = "131 MHz: nothing is held out; reduced chi^2 of the fitted data 0.997"
    assert say_result({"channels": [alone]}) == [expected]
