"""The estimator for a loop in real time as text."""

from eoi_jax.data.input_holds import hold_text
from eoi_jax.estimation.online import Alarm, OnlineEstimator
from eoi_jax.report.tables import gains_text


def online_text(estimator: OnlineEstimator) -> str:
    """What runs, which parameters it follows, and when its alarm is on.

    Args:
        estimator: of `online_estimator`, or made by itself.
    """
    plant, hold = estimator.plant, estimator.hold
    inputs = {"zero": "held", "linear": "linear"}.get(str(hold), hold_text(hold, plant.inputs))
    step = f"a step each {estimator.sample_period:.6g} s, inputs {inputs} between samples"
    values = zip(plant.names, estimator.theta, plant.free, strict=True)
    parameters = [f"{name} {value:.6g}{'' if free else ' (fixed)'}" for name, value, free in values]
    return "\n".join(
        [
            f"{plant.name}: estimator in real time, {step}",
            f"observer  {gains_text(estimator.observer)}",
            f"memory of the parameters  {_memory(estimator)}",
            f"parameters  {', '.join(parameters)}",
            f"alarm  {_alarm(estimator.alarm)}",
        ]
    )


def _alarm(alarm: Alarm | None) -> str:
    if alarm is None:
        return "none"
    ratio = f"{float(alarm.threshold):.3g} times that where the model holds"
    return f"where the power of the injection over {float(alarm.memory):.3g} s is above {ratio}"


def _memory(estimator: OnlineEstimator) -> str:
    forgetting = float(estimator.recursion.forgetting)
    if forgetting == 1.0:
        return "all samples"
    return f"about {estimator.sample_period / (1.0 - forgetting):.3g} s, forgetting {forgetting:g}"
