"""Arguments of a wrong type meet a house message, outside the tests' own type checks too."""

import subprocess
import sys

import numpy as np
import pytest

import eoi_jax as eoi

CALLS = {
    "identify(plant, None)": "`records` must hold at least one record, got none",
    "identify(plant, [3])": "`records` must be a Record or several, got int",
    "identify(plant, time)": "`records` must be a Record or several, got an array. Make one of it, "
    "`Record(time, inputs, outputs)`; for arrays there is `observe`.",
    "identify(plant, (time, time))": "`records` must be a Record or several, got an array.",
    "identify(plant, 'run.csv')": "`records` must be a Record or several, got run.csv. Read it",
    "identify(plant, 3)": "`records` must be a Record or several, got int",
    "identify('pendulum', run)": "`plant` must be a Plant, got str",
    "sweep(plant, run, substeps=2.5)": "`substeps` must be an integer ≥ 1, got 2.5",
    "refine(3, run)": "`plant` must be a Plant, got int",
    "validate('pendulum', run)": "`plant` must be a Plant, got str",
    "observe('pendulum', None, None, 0.01, time, time)": "`plant` must be a Plant, got str",
    "observe(plant, None, None, 0.01, time, time)": "`observer` must be an observer with its gains",
    "observe(plant, eoi.observers.SuperTwisting(9.0), None, 1, 1, 1, lowpass=9.0)": "`lowpass` must"
    " be a filter `LowPass(cutoff, order)`, got float",
    "observe(plant, eoi.observers.SecondOrder(9.0, 9.0, 9.0), None, 0.01, run, time)": "`y` must "
    "be an array, got a Record. Give its `outputs` and `inputs`.",
    "observe(plant, eoi.observers.SecondOrder(9.0, 9.0, 9.0), None, 0.01, time, time, noise=None)"
    "": "`noise` must be a number, or one for each output, got None. Leave it out",
    "observe(plant, eoi.observers.SecondOrder(9.0, 9.0, 9.0), None, 0.01, time, time, "
    "valid=time[1:] > 0)": "`valid` must have shape (500,) or (500, 1), a flag for each sample of",
    "RecursiveLeastSquares('a')": "`forgetting` must lie in (0, 1], got a",
    "online_estimator(plant, run)": "`result` must be a result of `identify`, got Plant",
    "export_estimator(plant, 'rig.c')": "`estimator` must be an OnlineEstimator, got Plant",
    "OnlineEstimator(3, None, None, 0.01)": "`plant` must be a Plant, got int",
    "OnlineEstimator(plant, eoi.observers.SuperTwisting(9.0), eoi.LowPass(9.0, 3), 0.01, alarm=5.0)"
    "": "`alarm` must be an Alarm or None, got float",
    "Alarm([1.0], '1 s', 5.0)": "`memory` must be positive and finite, got 1 s. It is a time in",
    "rollout('pendulum', None, None, time, 0.01)": "`plant` must be a Plant, got str",
    "validate(plant, None)": "`records` must hold at least one record, got none",
    "validate(plant, run, controller=max)": "`controller` must be a Controller, got",
    "Controller(3.0)": "`law` must be a function law(t, r, y, s), got 3.0",
    "Controller(max, (3.0,))": "`reference` must be a name or several, got",
    "compare('pendulum', run)": "`plant` must be a Plant, got str",
    "sweep('pendulum', run, None)": "`plant` must be a Plant, got str",
    "diagnose(plant)": "`identification` must be what `identify` returned, got Plant",
    "bootstrap(plant, run)": "`identification` must be what `identify` returned, got Plant",
    "remaining(plant)": "`refinement` must be what `refine` returned, got Plant",
    "profile(plant, run, 'a')": "`refinement` must be what `refine` returned, got Plant",
    "uncertainty(plant)": "`estimate` must be an estimate, got Plant",
    "sweep_to_pandas(plant)": "`sweep` must be what `sweep` returned, got Plant",
    "export_parameters(run, 'p.json')": "`result` must be a Plant or a result with an estimate, got"
    " Record",
    "export_robot(run, 'a.urdf', 'b.urdf', {})": "`result` must be a Plant or a result with an ",
    "export_robot(plant, 'a.urdf', 'b.urdf', {'a': 'b'})": "`joints` must be a dict of attributes "
    'by joint, {"shoulder": {"damping": "b"}}, got {\'a\': \'b\'}.',
    "export_robot(plant, 'a.urdf', 'b.urdf', {'a': {'damping': 'b'}})": "`robot` must be a file "
    "that can be read (No such file or directory), got a.urdf.",
    "Record.from_period(run.outputs, run.inputs, 0.01)": "`sample_period` must be positive and "
    "finite, got an array of shape (500, 1). It is the time between samples in seconds.",
    "Record.from_period(0.01, run.inputs, run.outputs, mask_faults='no')": "`mask_faults` must be "
    "True or False, got str.",
    "discover(plant, None)": "`records` must hold at least one record, got none",
    "discover(plant, run, [3])": "`validation` must be a Record or several, got int",
    "identify(plant, run, passes=True)": "`passes` must be an integer ≥ 1, got True",
    "identify(plant, run, transient='a')": "`transient` must be a time ≥ 0 in seconds, got a",
    "identify(plant, run, transient=[1.0])": "`transient` must be a time ≥ 0 in seconds, got [1.0]",
    "identify(plant, run, smoothing='a')": "`smoothing` must be a cut-off > 0 in rad/s, or False, "
    "got a",
    "identify(plant, run, lowpass=20.0)": "`lowpass` must be a filter `LowPass(cutoff, order)`, "
    "got float",
    "identify(plant, run, eoi.observers.SecondOrder)": "`observer` must be an observer "
    "with its gains, such as `SecondOrder(c1, c2, c3)`, got the class SecondOrder",
    "identify(plant, run, 3)": "`observer` must be an observer",
    "validate(plant, run, window='a')": "`window` must be positive and finite, got a",
    "validate(plant, run, initial_samples=9.5)": "`initial_samples` must be an integer ≥ 1",
    "simulate(None, time, time)": "`plant` must be a Plant, got NoneType",
    "compare(plant, run, methods=3)": "`methods` must be comparators or their names, got int",
    "compare(plant, run, methods=[3])": "`methods` must be comparators or their names, got int",
    "compare(plant, run, methods=['svg'])": "`methods` must be one of",
    "compare(plant, run, truth=3)": "`truth` must be a dict of values by name, got int",
    "sweep(plant, run, lowpass=3.0)": "`lowpass` must be filters `LowPass(cutoff, order)`, or "
    "None, got float",
    "sweep(plant, run, 3)": "`observers` must be observers with their gains, or "
    "`observers.gains(…)`, got int",
    "sweep(plant, run, part=1)": "`part` must be (i, n) with 0 ≤ i < n, got 1",
    "sweep(plant, run, part=(0.5, 2))": "`part` must be (i, n) with 0 ≤ i < n, got (0.5, 2)",
    "sweep(plant, run, smoothing=True)": "`smoothing` must be a cut-off > 0 in rad/s, or False, "
    "got True",
    "sweep(plant, run, transient=-3.0)": "`transient` must be a time ≥ 0 in seconds, got -3.0",
    "sweep(plant, run, starts=3)": "`starts` must be dicts of parameters, or rows, got int",
    "sweep(plant, run, seed=-1)": "`seed` must be an integer ≥ 0, got -1",
    "Plant(law, ['k'])": "`parameters` must be a dict by name, got list",
    "Plant(law, {'k': time})": "`parameters[k]` must be a number, got shape (500,). Give",
    "Plant(law, None)": "`parameters` must be a dict by name, got NoneType",
    "Plant(law, {'k': 'a'})": "`parameters` must be finite numbers, got {'k': 'a'}",
    "Plant(3, {'k': 1.0})": "`dynamics` must be a function f(t, x, u, p), got 3",
    "Plant(law, {'k': 1.0}, bounds={'k': 3.0})": "`bounds[k]` must be (lower, upper), got 3.0",
    "Plant(law, {'k': 1.0}, bounds=[1])": "`bounds` must be a dict by name, got list",
    "Plant(law, {'k': 1.0}, units=['N'])": "`units` must be a dict by name, got list",
    "Plant(law, {'k': 1.0}, units={'kk': 'N'})": "`units` must be one of k, u, y, got 'kk'",
    "Plant(law, {'k': 1.0}, fixed=3)": "`fixed` must be a name or several, got int",
    "Plant(law, {'k': 1.0}, outputs=[3])": "`outputs` must be a name or several, got int",
    "Plant(law, {'kk': 1.0})": "`p.k` must be one of kk, got 'k'. Did you mean `kk`?",
    "diagnose(eoi.identify(plant, run), level='a')": "`level` must lie in (0, 0.5), got a",
    "discover(plant, run, lowpass=3.0)": "`lowpass` must be a filter `LowPass(cutoff, order)`, got",
    "discover(plant, run, effects=3)": "`effects` must be a list of names or effects, got int",
    "discover(plant, run, effects=[eoi.effects.Gravity])": "`effects` must be names or effects, "
    "got the class Gravity",
    "discover(plant, run, alpha='a')": "`alpha` must lie in (0, 1), got a",
    "discover(plant, run, effects=[3])": "`effects` must be names or effects, got int",
    "discover(plant, run, most=1.5)": "`most` must be an integer ≥ 1, got 1.5",
    "discover(plant, run, alpha=2)": "`alpha` must lie in (0, 1), got 2",
    "discover(plant, run, (one for one in [run]))": "`validation[record]` must not be one of",
    "discover(plant, run, window='1 s')": "`window` must be positive and finite, got 1 s",
    "refine(plant, run, window='1 s')": "`window` must be positive and finite, got 1 s",
    "refine(plant, run, huber='x')": "`huber` must be positive and finite, got x",
    "refine(plant, run, starts=[{'b': 'x'}])": "`parameters[b]` must be a number, got 'x'",
    "refine(plant, run, starts=[['x', 1, 2]])": "`starts` must be dicts of parameters, or rows",
    "LowPass('1 Hz')": "`cutoff` must be positive and finite, got 1 Hz",
    "observers.HighOrder(1.0, 2.0)": "`degree` must be an integer ≥ 1, got 2.0",
    "uncertainty(found)": "`estimate` must be an estimate, got Discovery. Give its `.found`.",
    "diagnose(found)": "`identification` must be what `identify` returned, got Discovery. Give its "
    "`.found`.",
    "refine(found, run)": "`plant` must be a Plant, got Discovery. Give its `.plant`.",
    "validate(fit, run)": "`plant` must be a Plant, got Identification. Give its `.plant`.",
    "profile(found, run, 'a')": "`refinement` must be what `refine` returned, got Discovery.",
    "LowPass(1.0, 2.5)": "`order` must be an integer ≥ 1, got 2.5",
    # What NumPy counts is a count.
    "LowPass(1.0, np.int64(2)).order": "accepted 2",
    "observers.HighOrder(1.0, np.int64(2)).degree": "accepted 2",
    "Plant(law, {'k': 1.0}, np.int64(2)).degrees": "accepted (2,)",
    "identify(plant, run, passes=np.int64(1)).index.shape": "accepted (1, 1)",
    "sweep(plant, run, precision='float32', passes=np.int64(2)).sizes['pass']": "accepted 2",
}
SCRIPT = """
import eoi_jax as eoi
import numpy as np
plant = eoi.plants.pendulum()
time = 0.01 * np.arange(500)
run = eoi.Record(time, np.sin(time), np.cos(time))
def law(t, x, u, p):
    return -p.k * x.y[0] + u
fit, found = (object.__new__(kind) for kind in (eoi.Identification, eoi.Discovery))
object.__setattr__(found, "found", fit)
for one in (fit, found):
    object.__setattr__(one, "plant", plant)
for call in {calls!r}:
    try:
        value = eval("eoi." + call)
    except ValueError as error:
        print(error)
    else:
        print("accepted", value)
"""


@pytest.fixture(scope="module")
def answers() -> list[str]:
    script = SCRIPT.format(calls=list(CALLS))
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize("number", range(len(CALLS)), ids=list(CALLS))
def test_a_wrong_type_is_named_with_its_rule(answers: list[str], number: int):
    assert answers[number].startswith(list(CALLS.values())[number])


def test_methods_are_compared_by_name_as_by_object():
    time = 0.01 * np.arange(500)
    plant = eoi.plants.mass_spring_damper()
    run = eoi.simulate(plant, time, np.sign(np.sin(3.0 * time)))
    both = [["svf"], [eoi.comparators.StateVariableFilter()]]
    one, other = (eoi.compare(plant, run, methods=methods)["svf"] for methods in both)
    assert one.parameters == other.parameters
