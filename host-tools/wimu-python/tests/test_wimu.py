"""What the Python module promises. Each test's name is its claim.

Without arguments every test runs; an argument selects tests by a part of their name. pytest runs the file too.
WIMU_COMMAND is the command to compare with.
"""

import ast
import atexit
import csv
import inspect
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import wimu

CRATE = Path(__file__).resolve().parent.parent
ROOT = CRATE.parent.parent
DATA = ROOT.parent / "shared" / "data"
COMMAND = shlex.split(os.environ.get("WIMU_COMMAND", "cargo run --quiet --release -p wimu --"))
GRAVITY = 9.80665

# Bias, m/s², and matrix of the simulated sensor.
BIAS = np.array([0.3, -0.2, 0.1])
MATRIX = np.array([[1.02, 0.0, 0.0], [0.01, 0.99, 0.0], [-0.02, 0.015, 1.01]])


def run(*arguments, cwd=ROOT):
    """The data that a command prints with --json."""
    ran = subprocess.run([*COMMAND, *map(str, arguments), "--json"], cwd=cwd, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    return json.loads(ran.stdout.splitlines()[-1])["data"]


def figure(claim, measured, target, met):
    """Prints a figure; a campaign keeps it, too."""
    print(f"{claim}: {measured} (target: {target})")
    if results := os.environ.get("WIMU_RESULTS"):
        row = {"claim": claim, "figure": str(measured), "target": target, "met": bool(met), "test": "python"}
        with open(results, "a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
    assert met, f"{claim}: {measured} (target: {target})"


def folder():
    """A folder that lasts as long as the tests."""
    path = Path(tempfile.mkdtemp(prefix="wimu-python-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def public(name):
    """A public recording; None where they are absent."""
    path = DATA / name
    if not path.exists():
        print(f"skipped: {name} of the public recordings, ../shared/data, is absent")
        return None
    return path


def rests(seed=1, directions=14):
    """Times, s, and output, m/s², of a sensor at rest for 3 s in each of several orientations, with motion between."""
    random = np.random.default_rng(seed)
    # A spiral on the sphere.
    z = 1.0 - 2.0 * (np.arange(directions) + 0.5) / directions
    angle = 2.4 * np.arange(directions) + seed
    around = np.sqrt(1.0 - z**2)
    output = []
    for force in GRAVITY * np.stack([around * np.cos(angle), around * np.sin(angle), z], axis=1):
        output.append(np.tile(force, (300, 1)) + random.normal(scale=0.02, size=(300, 3)))
        output.append(force + random.normal(scale=4.0, size=(50, 3)))
    output = np.concatenate(output) @ MATRIX.T + BIAS
    return np.arange(len(output)) * 0.01, output


def write(path, times, **columns):
    """Writes a table in the columns of wimu."""
    names = ["Time (s)"]
    values = [times[:, None]]
    for name, (unit, rows) in columns.items():
        names += [f"{name} {axis} ({unit})" for axis in "XYZ"]
        values.append(rows)
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([[repr(float(v)) for v in row] for row in np.hstack(values)])
    return path


def walk(path):
    """Writes a recording of 30 s with gyroscope: rest, motion along an axis, rest."""
    times = np.arange(3000) * 0.01
    random = np.random.default_rng(3)
    force = np.tile([0.0, 0.0, GRAVITY], (3000, 1)) + random.normal(scale=0.01, size=(3000, 3))
    force[1000:1100, 0] += np.sin(np.arange(100) * 2 * np.pi / 100)
    rate = random.normal(scale=0.001, size=(3000, 3))
    return write(path, times, Accelerometer=("m/s²", force), Gyroscope=("rad/s", rate))


def same(ours, theirs, where=""):
    """Asserts that two JSON values are equal, but for when they were made."""
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), where
        for key in ours.keys() - {"utc_s", "parameter_id", "id"}:
            same(ours[key], theirs[key], f"{where}.{key}")
    elif isinstance(ours, list):
        assert len(ours) == len(theirs), where
        for index, pair in enumerate(zip(ours, theirs)):
            same(*pair, f"{where}[{index}]")
    else:
        assert ours == theirs, f"{where}: {ours} and {theirs}"


def fails(code, call, *arguments, **options):
    """Asserts that a call raises WimuError with this code; returns the error."""
    try:
        result = call(*arguments, **options)
    except wimu.WimuError as error:
        assert error.code == code, f"{error.code} instead of {code}: {error}"
        assert error.message and error.remedy and error.message in str(error)
        return error
    raise AssertionError(f"no error, but {result!r}")


def is_type_error(call, *arguments, **options):
    try:
        call(*arguments, **options)
    except TypeError:
        return
    raise AssertionError("no TypeError")


# What `cargo xtask test` runs.


def public_attributes():
    """Names and signatures of what the module offers, one a line."""
    lines = []
    for name, thing in sorted(vars(wimu).items()):
        # In a wheel, the library is a module in the package.
        if name.startswith("_") or inspect.ismodule(thing):
            continue
        if thing is wimu.WimuError:
            error = fails("file_unreadable", wimu.read, "absent.csv")
            lines += [f"class {name}({thing.__base__.__name__})"] + [f"  {member}" for member in sorted(vars(error))]
        elif inspect.isclass(thing):
            lines.append(f"class {name}{inspect.signature(thing) if name == 'Recording' else ''}")
            for member, what in sorted(vars(thing).items()):
                if member == "__len__" or not member.startswith("_"):
                    lines.append(f"  {member}{inspect.signature(what) if callable(what) else ''}")
        else:
            lines.append(f"{name}{inspect.signature(thing)}")
    return lines


def test_smoke_the_public_attributes_match_the_frozen_fixture():
    frozen = ROOT / "tests/vectors/compat/python.txt"
    found = public_attributes()
    if "WIMU_WRITE_COMPAT" in os.environ:
        frozen.write_text("\n".join(found) + "\n", encoding="utf-8")
    kept = frozen.read_text(encoding="utf-8").splitlines()
    assert found == kept, f"see {frozen.parent}/README.md: {set(kept) ^ set(found)}"


def test_smoke_a_calibration_equals_that_of_the_command_line():
    times, output = rests()
    made = write(folder() / "rests.csv", times, Accelerometer=("m/s²", output))
    same(wimu.calibrate(made).to_dict(), run("calibrate", made))
    counts = write(folder() / "counts.csv", times, Accelerometer=("LSB", np.round(output / GRAVITY * 4096)))
    ours = wimu.calibrate(counts, sensitivity=4096, gravity=9.81, model="auto")
    same(ours.to_dict(), run("calibrate", counts, "--sensitivity", 4096, "--gravity", 9.81, "--model", "auto"))
    if means := public("calibration/innalabs_49_pose_means.csv"):
        ours = wimu.calibrate(wimu.read(means, poses=True))
        theirs = run("calibrate", means, "--poses")
        same(ours.to_dict(), theirs)
        assert ours.bias.tolist() == theirs["model"]["bias_m_s2"]
        assert ours.matrix.tolist() == theirs["model"]["matrix"]
        assert ours.covariance.tolist() == theirs["covariance"]
        assert ours.bias_sd.tolist() == theirs["sd"]["bias_m_s2"]


# The campaign runs these, too.


def test_tracks_are_read_only_arrays_with_quantity_unit_and_mask():
    times, output = rests(directions=2)
    output[7, 1] = np.nan
    path = write(folder() / "a.csv", times, Accelerometer=("m/s²", output), Gyroscope=("deg/s", output))
    recording = wimu.read(path)
    assert recording.format == "table"
    force, rate = recording.tracks
    assert (force.quantity, force.unit, force.sensor) == ("specific force", "m/s²", 0)
    assert (rate.quantity, rate.unit) == ("angular rate", "rad/s")
    assert abs(force.rate_hz - 100.0) < 1e-9 and len(force) == len(times)
    assert np.array_equal(force.times, times) or np.allclose(force.times, times, atol=1e-9)
    assert force.times_ns.dtype == np.int64 and force.values.shape == (len(times), 3)
    assert not force.valid[7] and force.valid.sum() == len(times) - 1
    assert np.array_equal(force.values[force.valid], output[force.valid])
    assert np.allclose(rate.values[:7], np.radians(output[:7]))
    assert [found["code"] for found in recording.findings] == ["rows_masked"]
    assert recording.tracks[0] is force and "specific force" in repr(force)
    try:
        force.values[0, 0] = 1.0
    except ValueError:
        return
    raise AssertionError("values can be written to")


def test_every_public_file_is_read_as_by_an_independent_reader():
    if not (checks := public("formats/checks.csv")):
        return
    with open(checks, encoding="utf-8") as file:
        rows = [row for row in list(csv.reader(file))[1:] if not row[0].endswith("_db3")]
    equal = 0
    for name, channel, _, samples, _, _, *vectors in rows:
        topic = "sensor_accel" if channel.startswith("sensor_accel") else None
        ends = np.array(vectors[:6], dtype=float).reshape(2, 3)
        tracks = [track.values[track.valid] for track in wimu.read(DATA / "formats" / name, topic=topic).tracks]
        tracks = [values for values in tracks if values.shape == (int(samples), 3)]
        equal += any(np.allclose(values[[0, -1]], ends, rtol=1e-6, atol=1e-8) for values in tracks)
    figure("public files read as by an independent reader", equal, f"{len(rows)}", equal == len(rows))


def test_arrays_give_the_calibration_of_the_same_file():
    times, output = rests()
    path = write(folder() / "rests.csv", times, Accelerometer=("m/s²", output))
    of_file, of_arrays = wimu.calibrate(path), wimu.calibrate(wimu.Recording(times, output))
    assert np.array_equal(of_file.bias, of_arrays.bias) and np.array_equal(of_file.covariance, of_arrays.covariance)
    of_lists = wimu.calibrate(wimu.Recording(times.tolist(), output.astype(np.float32)))
    assert np.allclose(of_lists.bias, of_file.bias, atol=1e-4)


def test_the_errors_of_a_simulated_sensor_are_found_within_their_uncertainty():
    normalised = []
    for seed in range(20):
        # With few degrees of freedom, error over σ has Student's t distribution, which is wider.
        found = wimu.calibrate(wimu.Recording(*rests(seed, 40)), gravity=GRAVITY)
        normalised.append((found.bias - BIAS) / found.bias_sd)
        assert found.rms < 0.01 and found.poses == 40
        lower = np.tril_indices(3)
        assert np.allclose(found.matrix[lower], MATRIX[lower], atol=0.002)
    rms = float(np.sqrt(np.mean(np.square(normalised))))
    figure("20 simulated calibrations: bias error over its σ, rms", f"{rms:.2f}", "0.7 to 1.3", 0.7 < rms < 1.3)


def test_the_covariance_agrees_with_the_standard_deviations():
    found = wimu.calibrate(wimu.Recording(*rests()))
    assert found.covariance.shape == (12, 12) and np.allclose(found.covariance, found.covariance.T)
    sd = np.concatenate([found.bias_sd, found.matrix_sd.ravel()])
    assert np.allclose(np.sqrt(np.diag(found.covariance)), sd)
    assert found.bias.shape == (3,) and found.matrix.shape == found.matrix_sd.shape == (3, 3)
    assert found.sensitivity is None and "bias" in str(found) and isinstance(found.findings, list)


def test_a_saved_calibration_corrects_as_the_object_and_the_command_do():
    here, recording = folder(), wimu.Recording(*rests())
    path = write(here / "rests.csv", *rests()[:1], Accelerometer=("m/s²", rests()[1]))
    found = wimu.calibrate(recording)
    found.save(here / "CAL.json")
    by_object, by_file = wimu.apply(found, recording), wimu.apply(here / "CAL.json", path, output=here / "ours.csv")
    assert np.array_equal(by_object.specific_force, by_file.specific_force)
    run("convert", path, "--with", here / "CAL.json", "-o", here / "theirs.csv")
    assert (here / "ours.csv").read_text() == (here / "theirs.csv").read_text()
    norms = np.linalg.norm(by_object.specific_force[:300], axis=1)
    assert abs(norms.mean() - GRAVITY) < 0.02 and by_object.angular_rate is None
    expected = (recording.tracks[0].values - found.bias) @ np.linalg.inv(found.matrix).T
    assert np.allclose(by_object.specific_force, expected)


def test_noise_equals_that_of_the_command_line_and_of_the_simulation():
    random, density = np.random.default_rng(5), 0.002
    output = random.normal(scale=density * np.sqrt(50.0), size=(60000, 3)) + [0.0, 0.0, GRAVITY]
    path = write(folder() / "rest.csv", np.arange(60000) * 0.01, Accelerometer=("m/s²", output))
    noise = wimu.allan(path)
    same(noise.to_dict(), run("allan", path))
    assert noise.deviation.shape == noise.deviation_sd.shape == (len(noise.tau), 3)
    assert noise.bias_instability.shape == (3,) and noise.rate_hz == noise.to_dict()["rate_hz"]
    worst = float(np.max(np.abs(noise.noise_density - density) / noise.noise_density_sd))
    figure("simulated white noise: density error over its σ, worst axis", f"{worst:.1f}", "below 4", worst < 4)
    assert np.allclose(noise.velocity_random_walk * np.sqrt(2), noise.noise_density)


def test_a_path_equals_that_of_the_command_line():
    here = folder()
    for profile, zupt in [("hand", "on"), ("vehicle", "cautious"), ("free", "off")]:
        path = wimu.navigate(walk(here / "walk.csv"), profile=profile, zupt=zupt)
        path.save(here / "ours.csv")
        told = run("navigate", here / "walk.csv", "--profile", profile, "--zupt", zupt, "-o", here / "theirs.csv")
        assert (here / "ours.csv").read_text() == (here / "theirs.csv").read_text()
        assert path.method == told["method"] and path.distance == told["distance_m"]
        assert path.position[-1].tolist() == told["final_position_m"]
        assert path.position_sd[-1].tolist() == told["final_sigma_m"]
        rows = len(path)
        assert path.times.shape == path.valid.shape == path.resting.shape == (rows,)
        assert path.velocity.shape == path.velocity_sd.shape == path.attitude_sd.shape == (rows, 3)
        assert path.attitude.shape == (rows, 4) and path.position_covariance.shape == (rows, 3, 3)
        assert np.allclose(np.linalg.norm(path.attitude, axis=1), 1.0)
        variances = np.diagonal(path.position_covariance, axis1=1, axis2=2)
        assert np.allclose(np.sqrt(variances), path.position_sd, equal_nan=True)


def test_moves_of_a_recording_of_wimu_equal_those_of_the_command_line():
    here = folder()
    run("demo", "--report", here / "demo.html", cwd=here)
    recording = wimu.read(next(here.glob("*.mcap")))
    assert recording.format == "wimu recording"
    for link in ("cable", "wireless"):
        of_link = wimu.read(next(here.glob("*.mcap")), link=link)
        path = wimu.navigate(of_link)
        told = run("navigate", next(here.glob("*.mcap")), "--topic", link)["path"]
        lengths = [move.length if move.valid else None for move in path.moves]
        assert lengths == [move["length_m"] for move in told["moves"]]
        assert [move.start for move in path.moves] == [move["from_s"] for move in told["moves"]]
        assert len(path.moves) >= 2 and all(move.end > move.start for move in path.moves)
    same(wimu.calibrate(recording).to_dict(), run("calibrate", next(here.glob("*.mcap"))))


def test_bad_input_raises_wimu_error_with_code_place_and_remedy():
    here = folder()
    for call in (wimu.read, wimu.calibrate, wimu.allan, wimu.navigate):
        assert str(here / "none.csv") in fails("file_unreadable", call, here / "none.csv").where
    empty = here / "empty.csv"
    empty.write_text("")
    fails("csv_empty", wimu.read, empty)
    times, output = rests()
    nothing = wimu.Recording([], np.zeros((0, 3)))
    for call in (wimu.calibrate, wimu.allan):
        fails("no_rows", call, nothing)
    fails("no_rows", wimu.navigate, nothing)
    fails("data_refused", wimu.Recording, times, np.full_like(output, np.nan))
    fails("data_refused", wimu.Recording, times[::-1], output)
    for bad in (np.nan, np.inf, 1e30):
        fails("usage", wimu.Recording, [0.0, bad], output[:2])
    fails("usage", wimu.Recording, times[1:], output)
    fails("usage", wimu.Recording, times, output[:, :2])
    fails("usage", wimu.Recording, [], np.zeros((0, 0)))
    fails("usage", wimu.Recording, times, output, unit="mile")
    fails("usage", wimu.Recording, times, output, temperature=times[1:])
    recording = wimu.Recording(times, output)
    still = wimu.Recording(times[:300], output[:300])
    assert "pose" in fails("data_refused", wimu.calibrate, still).message
    fails("data_refused", wimu.allan, wimu.Recording(times[:5], output[:5]))
    for options in (
        {"method": "none"}, {"model": "7"}, {"model": "9+none"}, {"gravity": 1.0}, {"gravity": np.nan},
        {"sensitivity": -1.0}, {"placement_sd": np.nan, "method": "six-position"}, {"sides": ["up"]},
        {"sides": ["x"], "method": "six-position"}, {"sensor_model": "none"}, {"accelerometer": 7},
    ):
        fails("usage", wimu.calibrate, recording, **options)
    fails("usage", wimu.allan, recording, sensitivity=np.nan)
    for options in ({"zupt": "none"}, {"limit": np.nan}, {"sensitivity": 0.0}):
        fails("usage", wimu.navigate, recording, **options)
    for options in ({"link": "none"}, {"where": "x"}, {"format": "none"}):
        fails("usage", wimu.read, write(here / "a.csv", times, Accelerometer=("m/s²", output)), **options)
    fails("file_unreadable", wimu.apply, here / "none.json", recording)
    (here / "bad.json").write_text("{}")
    fails("bad_calibration", wimu.apply, here / "bad.json", recording)
    found = wimu.calibrate(recording)
    fails("file_unreadable", found.save, here / "none" / "CAL.json")
    counts = wimu.Recording(times, np.round(output * 400), unit="LSB")
    fails("unknown_format", wimu.apply, found, counts)
    fails("unknown_format", wimu.navigate, counts)


def test_arguments_of_a_wrong_type_raise_type_error():
    times, output = rests(directions=2)
    for call in (wimu.read, wimu.calibrate, wimu.allan, wimu.navigate):
        is_type_error(call)
        is_type_error(call, 7)
        is_type_error(call, None)
        is_type_error(call, output)
    recording = wimu.Recording(times, output)
    is_type_error(wimu.calibrate, recording, method=7)
    is_type_error(wimu.calibrate, recording, sides="x,-x")
    is_type_error(wimu.calibrate, recording, none=1)
    is_type_error(wimu.apply, recording, recording)
    is_type_error(wimu.apply, 7, recording)
    for bad in (None, 7, "x", times):
        is_type_error(wimu.Recording, times, bad)
    is_type_error(wimu.Recording, output, output)


def test_damaged_files_raise_wimu_error_or_are_read():
    here, random = folder(), np.random.default_rng(1)
    whole = walk(here / "walk.csv").read_bytes()[:20000]
    read, others = 0, []
    for round_ in range(200):
        damaged = bytearray(whole[: random.integers(len(whole))])
        for place in random.integers(max(len(damaged), 1), size=5):
            if damaged:
                damaged[place] = random.integers(256)
        path = here / f"{round_}.csv"
        path.write_bytes(bytes(damaged) if round_ % 4 else random.bytes(500))
        for call in (wimu.read, wimu.calibrate, wimu.allan, wimu.navigate):
            try:
                call(path)
                read += 1
            except wimu.WimuError:
                pass
            except BaseException as error:  # a panic is no Exception
                others.append(repr(error))
    figure("damaged tables, 4 functions on 200: other exceptions", len(others), "0", not others)
    assert read > 100, read


def test_the_stubs_name_what_the_module_has():
    tree = ast.parse((CRATE / "wimu.pyi").read_text(encoding="utf-8"))
    # In a wheel, the library is a module in the package.
    public_names = {name for name, what in vars(wimu).items() if not (name.startswith("_") or inspect.ismodule(what))}
    stubs = {node.name: node for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    typed = {name for name in stubs if not name.startswith("_")} - {"Finding"}
    assert typed == public_names, typed ^ public_names

    def arguments(node):
        return [a.arg for a in node.args.posonlyargs + node.args.args + node.args.kwonlyargs]

    def parameters(what):
        return list(inspect.signature(what).parameters)

    for name in typed:
        node, thing = stubs[name], getattr(wimu, name)
        if isinstance(node, ast.FunctionDef):
            assert arguments(node) == parameters(thing), name
            continue
        members = {member.name: member for member in node.body if isinstance(member, ast.FunctionDef)}
        fields = {member.target.id for member in node.body if isinstance(member, ast.AnnAssign)}
        if name == "WimuError":
            continue
        own = {member for member in vars(thing) if not member.startswith("_")}
        assert own == fields | {member for member in members if not member.startswith("_")}, name
        for member in own & members.keys():
            if callable(getattr(thing, member)):
                assert arguments(members[member]) == parameters(getattr(thing, member)), f"{name}.{member}"
    assert arguments(next(m for m in stubs["Recording"].body if getattr(m, "name", "") == "__init__"))[1:] == parameters(
        wimu.Recording
    )


def test_the_lines_of_the_readme_run():
    code = re.findall(r"```python\n(.*?)```", (CRATE / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    here, before = folder(), os.getcwd()
    times, output = rests()
    write(here / "rests.csv", times, Accelerometer=("m/s²", output))
    walk(here / "walk.csv")
    still = np.random.default_rng(1).normal(scale=0.02, size=(20000, 3)) + [0.0, 0.0, GRAVITY]
    write(here / "still.csv", np.arange(20000) * 0.01, Accelerometer=("m/s²", still))
    os.chdir(here)
    try:
        names = {"times": times, "output": output}
        assert code, "the README has code"
        for block in code:
            exec(compile(block, "README.md", "exec"), names)
    finally:
        os.chdir(before)


def test_the_example_leaves_little_of_the_errors():
    script = CRATE / "examples" / "calibrate_and_correct.py"
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, cwd=folder())
    assert ran.returncode == 0, ran.stderr
    before, after = (float(value) for value in re.findall(r"([\d.]+) mm/s²", ran.stdout)[-2:])
    figure("example: |f| − g before and after, mm/s² rms", f"{before:.0f}, {after:.1f}", "20 times less", after < before / 20)


def main(parts):
    tests = {name: test for name, test in globals().items() if name.startswith("test_")}
    chosen = [name for name in tests if not parts or any(part in name for part in parts)]
    if not chosen:
        sys.exit(f"no test is named by {parts}")
    for name in chosen:
        tests[name]()
        print(f"ok {name.removeprefix('test_').replace('_', ' ')}")
    # `cargo xtask` reads it: a test that fails ends the run.
    print(f"test result: ok. {len(chosen)} passed; 0 failed")


if __name__ == "__main__":
    main(sys.argv[1:])
