"""Flies an FMU with FMPy, which knows nothing of Whirlstand, through the inputs of a CSV, and compares every output of every
step with the other columns: bit for bit."""

import argparse
import csv
import shutil

from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu


class Flight:
    """An instance of the FMU, and its variables by name."""

    def __init__(self, path: str, folder: str):
        self.description = read_model_description(path, validate=True)
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU3Slave(
            guid=self.description.guid,
            unzipDirectory=folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="flight",
        )
        try:
            self.fmu.instantiate(loggingOn=True, logMessage=lambda _e, _s, _c, text: self.messages.append(text.decode()))
        except Exception as error:
            raise AssertionError(self.messages) from error

    def reference(self, name: str) -> int:
        return self.variables[name].valueReference

    def names(self, causality: str) -> list[str]:
        return [v.name for v in self.description.modelVariables if v.causality == causality]

    def get(self, names: list[str]) -> list[float]:
        return self.fmu.getFloat64([self.reference(name) for name in names])

    def set(self, name: str, value: float):
        self.fmu.setFloat64([self.reference(name)], [value])

    def begin(self, seed: int):
        self.fmu.setUInt64([self.reference("seed")], [seed])
        self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()


def check_bits(flight: Flight, rows: list[dict[str, float]], seed: int):
    flight.begin(seed)
    inputs, outputs = flight.names("input"), flight.names("output")
    assert inputs and outputs
    period = rows[1]["t"] - rows[0]["t"]
    kept = None
    for k, row in enumerate(rows):
        found = flight.get(outputs)
        wanted = [row[name] for name in outputs]
        assert found == wanted, f"step {k}: {dict(zip(outputs, found))}, not {dict(zip(outputs, wanted))}"
        if k == len(rows) // 2 and kept is None:
            kept = flight.fmu.getFMUState()
        for name in inputs:
            flight.set(name, row[name])
        flight.fmu.doStep(k * period, period)
    # The state of the middle gives the middle again.
    middle = len(rows) // 2
    flight.fmu.setFMUState(kept)
    assert flight.get(outputs) == [rows[middle][name] for name in outputs]
    flight.fmu.freeFMUState(kept)
    print(f"{len(rows)} steps of {len(outputs)} outputs are equal")


def check_refusal(flight: Flight):
    try:
        flight.fmu.doStep(-5.0, 0.1)
    except Exception:
        assert "time must go on" in flight.messages[-1], flight.messages
    else:
        raise AssertionError("a step back in time was taken")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("fmu")
    parser.add_argument("csv")
    parser.add_argument("--seed", type=int, required=True)
    options = parser.parse_args()
    problems = validate_fmu(options.fmu)
    assert not problems, problems
    with open(options.csv) as file:
        lines = list(csv.reader(file))
    names = [head.split("[")[0] for head in lines[0]]
    rows = [dict(zip(names, map(float, line))) for line in lines[1:]]
    folder = extract(options.fmu)
    try:
        flight = Flight(options.fmu, folder)
        check_bits(flight, rows, options.seed)
        check_refusal(flight)
        flight.fmu.terminate()
        flight.fmu.reset()
        check_bits(flight, rows, options.seed)
        flight.fmu.freeInstance()
    finally:
        shutil.rmtree(folder)
    # As a tool simulates it: from a state of the user's choice, with the steps that it likes.
    state = next(name for name in flight.variables if name.startswith("state."))
    result = simulate_fmu(
        options.fmu, stop_time=0.5, output_interval=0.0125, start_values={state: 0.05, "noise": False}, output=[state]
    )
    assert result[state][0] == 0.05, result[:2]
    assert len(result) == 41
    assert any(value != 0.05 for value in result[state]), "nothing moves"
    print("simulated by FMPy")


main()
