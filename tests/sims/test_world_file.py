"""World files: what is refused, and that every complaint says where and what."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from sims.errors import WorldError
from sims.truth import true_d_mm, true_planes_mm, true_steps_mm
from sims.world import World, load_world

WORLDS = Path(__file__).parents[2] / "configs" / "worlds"
TEXT = (WORLDS / "misaligned.yaml").read_text()
Writer = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Writer:
    def written(text: str) -> Path:
        path = tmp_path / "w.yaml"
        path.write_text(text)
        return path

    return written


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


@pytest.mark.parametrize("name", ["ideal", "aligned", "misaligned"])
def test_shipped_worlds_load(name: str) -> None:
    world = load_world(WORLDS / f"{name}.yaml")
    names = {"mirror_step_y", "mirror_step_x", "fan_y", "fan_x", "freeform", "mirror_step_tilted"}
    assert set(world.objects) == names
    assert world.camera.size_px == (2048, 2048)


def test_shipped_worlds_differ_only_in_what_their_names_say() -> None:
    worlds = [load_world(WORLDS / f"{name}.yaml") for name in ("ideal", "aligned", "misaligned")]
    noise = {"bits", "psf_px", "read_noise_e", "shot_noise"}
    for world in worlds:
        assert world.camera.model_dump(exclude=noise) == worlds[0].camera.model_dump(exclude=noise)
        assert world.objects == worlds[0].objects
    ideal, aligned, misaligned = worlds
    assert (ideal.camera.read_noise_e, ideal.camera.shot_noise, ideal.camera.psf_px) == (0, False, 0)
    assert ideal.stage1.position_noise_um == ideal.stage2.position_noise_um == 0
    assert aligned.glass == ideal.glass
    assert misaligned.glass.tilt_about_y_deg == misaligned.stage1.axis_tilt_about_y_deg == 0.1
    assert misaligned.projector.tilt_about_y_deg == 1.0
    half_width = 512 * 10.8e-3 / 50
    assert misaligned.projector.distortion[0] * half_width**2 == pytest.approx(0.003, rel=1e-4)
    assert misaligned.projector.gamma == 1.05


def test_true_values_are_those_of_the_file() -> None:
    world = load_world(WORLDS / "misaligned.yaml")
    assert true_steps_mm(world, "mirror_step_y") == pytest.approx([3.9868, 7.0248, 5.0062, 6.0986], abs=1e-12)
    expected = [6.50038, 5.50026, 5.00026, 4.00015, 3.00016]
    assert true_steps_mm(world, "fan_x") == pytest.approx(expected, abs=1e-12)
    assert true_steps_mm(world, "freeform") == [3.0]
    assert true_d_mm(world) == 180.0
    # Tilted about y by +0.6 deg, tread 1 falls along x; its centroid keeps its height.
    plane = true_planes_mm(world, "mirror_step_tilted")[1]
    assert plane[1] == pytest.approx(-0.010472, abs=1e-6)
    flat = true_planes_mm(world, "mirror_step_y")
    assert flat[:, 0].mean() + (flat[0, 0] + flat[-1, 0]) / 2 == pytest.approx(flat[:, 0].mean(), abs=1e-12)


def test_unknown_key_names_the_nearest_known_one(write: Writer) -> None:
    text = TEXT.replace("  psf_px:", "  psf_pix:")
    with pytest.raises(WorldError) as caught:
        load_world(write(text))
    line = line_of(text, "  psf_pix")
    assert f"w.yaml:{line}:3: camera.psf_pix: unknown key; did you mean 'psf_px'?" in str(caught.value)
    assert "camera.psf_px: is missing" in str(caught.value)


def test_unknown_key_in_an_object_is_compared_with_that_objects_keys(write: Writer) -> None:
    text = TEXT.replace("    outer_segments:", "    outer_segment:")
    with pytest.raises(WorldError, match=r"objects\.fan_y\.outer_segment: unknown key; did you mean 'outer_segments'"):
        load_world(write(text))
    text = TEXT.replace("bump_height_mm", "bump_hight_mm", 1)
    with pytest.raises(WorldError, match=r"mirrors\.0\.bump_hight_mm: unknown key; did you mean 'bump_height_mm'"):
        load_world(write(text))


def test_all_errors_are_told_at_once_each_with_its_place(write: Writer) -> None:
    text = TEXT.replace("psf_px: 0.7", "psf_px: -1").replace("bits: 8\n  gain", "bits: 12\n  gain")
    text = text.replace("scale_error_ppm: 0.0", "scale_error_ppm: fast")
    with pytest.raises(WorldError) as caught:
        load_world(write(text))
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    for part, key in (
        ("psf_px: -1", "camera.psf_px"),
        ("bits: 12", "camera.bits"),
        ("ppm: fast", "stage1.scale_error_ppm"),
    ):
        assert any(line.startswith(f"w.yaml:{line_of(text, part)}:") and key in line for line in lines)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("centre_mm: [36.0, 0.0, 0.0]", "centre_mm: [36.0, 0.0, 175.0]", "reaches behind the glass"),
        (
            "centre_mm: [125.0, 0.0, 180.0]",
            "centre_mm: [125.0, 0.0, 1900.0]",
            "not between the projector and the mirror",
        ),
        ("centre_mm: [125.0, 0.0, 180.0]", "centre_mm: [125.0, 0.0, -1.0]", "behind the reference plane"),
        ("position_mm: [-160.0, 0.0, 330.0]", "position_mm: [36.0, 0.0, 5.0]", "camera is inside the object"),
        ("position_mm: [-160.0, 0.0, 330.0]", "position_mm: [36.0, 0.0, -5.0]", "behind the reference plane"),
        ("size_mm: [250.0, 250.0]", "size_mm: [0.0, 250.0]", "greater than or equal to"),
        ("base_mm: -20.0", "base_mm: 30.0", "base is not below facet 0"),
        ("kc: [-0.13744, 0.14780", "kc: [-3.0, 0.0", "folds the image"),
        ("distortion: [0.24529", "distortion: [-30.0", "folds the picture"),
        ("warp_amplitude_px: 0.0", "warp_amplitude_px: 200.0", "warp folds"),
        ("axis: [0.0, 0.0, -1.0]", "axis: [0.0, 0.0, 1.0]", "looks away from the glass"),
        ("axis: [0.0, 0.0, -1.0]", "axis: [0.0, 0.0, 0.0]", "has no direction"),
        ("axis: [0.0, 0.0, -1.0]", "axis: [2.0, 0.0, 0.0]", "parallel to x"),
        ("sprayed_x_mm: [-60.0, -12.0]", "sprayed_x_mm: [-50.0, -12.0]", "reaches one of its two ends"),
        ("centre_mm: [36.0, 19.0, 3.0]", "centre_mm: [36.0, 5.0, 3.0]", "this mirror stands in mirror 0"),
        ("radius_x_mm: 100.0", "radius_x_mm: 15.0", "larger than its radii"),
        ("tilts_deg: [[0.6, 0.0], ", "tilts_deg: [", "one pair for each of the 5 facets"),
        ("steps_mm: [3.9868, ", "steps_mm: [-3.9868, ", "greater than or equal to"),
        ("outer_radius_mm: 162.0", "outer_radius_mm: 60.0", "must be below outer_radius_mm"),
        ("type: mirror_step", "type: staircase", "staircase"),
        ("  mirror_step_y:", "  mirror:", "this name is taken"),
        ("distance_mm: [230.0, 420.0]", "distance_mm: [430.0, 420.0]", "low <= high"),
        ("travel_mm: [-80.0, 220.0]", "travel_mm: [10.0, 220.0]", "0 between them"),
        ("full_well_e: 13500.0", "full_well_e: .inf", "finite"),
        ("full_well_e: 13500.0", "full_well_e: true", "valid number"),
        ("seed: 1", "seed: -1", "greater than or equal to 0"),
        ("axis: [0.0, 0.0, -1.0]", "axis: [1.0e+200, 0.0, -1.0e+200]", "less than or equal to"),
        ("axis: [0.0, 0.0, -1.0]", "axis: [0.0, 0.0, -1.0e-200]", "has no direction"),
        ("axis: [0.0, 0.0, -1.0]", "axis: [0.3, 0.0, -1.0]", "does not light the glass's centre"),
        ("position_mm: [80.0, 0.0, 1850.0]", "position_mm: [400.0, 0.0, 1850.0]", "does not light the glass's centre"),
        ("position_mm: [80.0, 0.0, 1850.0]", "position_mm: [80.0, 0.0, 100.0]", "not between the projector"),
        ("travel_mm: [-80.0, 220.0]", "travel_mm: [-181.0, 220.0]", "stage1 drives the mirror through the glass"),
        ("centre_mm: [36.0, 0.0, 0.0]", "centre_mm: [36.0, 0.0, 100.0]", "drives the object 'fan_y' through the glass"),
        ("position_mm: [80.0, 0.0, 1850.0]", "position_mm: [80.0, 0.0, 1.0e+7]", "less than or equal to 1000000"),
        ("gain: 1.0", "gain: 1.0e-9", "greater than or equal to"),
        ("read_noise_e: 13.0", "read_noise_e: 1.0e+12", "less than or equal to"),
        ("full_well_e: 13500.0", "full_well_e: 1.0e+300", "less than or equal to"),
        ("bump_width_mm: 5.0", "bump_width_mm: 1.0e-4", "greater than or equal to 0.001"),
    ],
)
def test_impossible_worlds_are_refused_with_their_place(write: Writer, old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(WorldError, match=message) as caught:
        load_world(write(TEXT.replace(old, new)))
    assert all(line.startswith("w.yaml:") for line in str(caught.value).splitlines())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 1\nseed: 2\n", "w.yaml:2:1: .*duplicate key"),
        ("a: &x 1\nb: *x\n", "w.yaml:1:4: anchors and aliases"),
        ("a: !!python/object:os.system 1\n", "w.yaml:1:4: tags are not accepted"),
        ("a: [1, 2\n", r"w.yaml:\d+:\d+: "),
        ("- 1\n", "mapping of keys"),
        ("", "mapping of keys"),
        ("a: 1\n---\nb: 2\n", "one document"),
        ("a: " + "[" * 30 + "]" * 30 + "\n", "nested deeper"),
        ("a: \x01\n", "w.yaml"),
        ("# " + "x" * 64_000, "larger than"),
        ("a: [" + "1," * 20_000 + "1]", "too many values"),
        (f"seed: {'9' * 5000}\n", "w.yaml"),
    ],
)
def test_unsafe_or_broken_yaml_is_one_clear_error(write: Writer, text: str, message: str) -> None:
    with pytest.raises(WorldError, match=message) as caught:
        load_world(write(text))
    assert "\n" not in str(caught.value) or "is missing" in str(caught.value)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="cannot be read: No such file"):
        load_world(tmp_path / "none.yaml")
    with pytest.raises(WorldError, match="cannot be read"):
        load_world(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"a: \xff\n")
    with pytest.raises(WorldError, match="not UTF-8"):
        load_world(tmp_path / "latin.yaml")


@pytest.mark.parametrize("path", [None, 5, "a\0b"])
def test_what_is_no_path_is_refused(path: object) -> None:
    with pytest.raises(WorldError, match="path"):
        load_world(path)  # type: ignore[arg-type]


@given(text=st.text(max_size=200))
def test_any_text_is_a_world_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("any") / "w.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    with pytest.raises(WorldError):
        load_world(path)


def test_a_world_survives_a_round_trip(tmp_path: Path) -> None:
    world = load_world(WORLDS / "misaligned.yaml")
    path = tmp_path / "again.yaml"
    with path.open("w") as file:
        YAML().dump(world.model_dump(mode="json"), file)
    assert load_world(path) == world


def test_worlds_are_frozen(aligned: World) -> None:
    with pytest.raises(ValueError, match="frozen"):
        aligned.seed = 3  # type: ignore[misc]
    with pytest.raises(ValueError, match="frozen"):
        aligned.camera.bits = 10  # type: ignore[misc]


def test_a_smaller_camera_keeps_its_field_of_view(aligned: World) -> None:
    full = load_world(WORLDS / "aligned.yaml").camera
    for axis in range(2):
        for edge in (-0.5, None):
            left = edge if edge is not None else full.size_px[axis] - 0.5
            small = edge if edge is not None else aligned.camera.size_px[axis] - 0.5
            assert (small - aligned.camera.cc_px[axis]) / aligned.camera.fc_px[axis] == pytest.approx(
                (left - full.cc_px[axis]) / full.fc_px[axis], rel=1e-12
            )


@pytest.mark.parametrize("width_px", [0, -5, 63, 8193, 10**6, 2.5, 256.0, True, None, "256"])
def test_a_camera_of_no_sane_size_is_refused(aligned: World, width_px: object) -> None:
    with pytest.raises(WorldError, match="64 to 8192 whole columns"):
        aligned.with_camera_size(width_px)  # type: ignore[arg-type]


def test_a_resized_world_is_validated(aligned: World) -> None:
    flat = aligned.camera.model_copy(update={"size_px": (256, 16)})
    with pytest.raises(WorldError, match="with 64 columns"):
        aligned.model_copy(update={"camera": flat}).with_camera_size(64)
