"""A dialect file says everything that differs between controllers; a wrong one says where it is wrong."""

from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from drivers.stage.dialect import DIALECT_FOLDER, load_dialect

SHIPPED = sorted(path.stem for path in DIALECT_FOLDER.glob("*.yaml"))


def changed(tmp_path: Path, old: str, new: str, name: str = "gsc") -> str:
    text = (DIALECT_FOLDER / f"{name}.yaml").read_text()
    assert old in text
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new, 1))
    return str(path)


def test_three_dialects_are_shipped() -> None:
    assert SHIPPED == ["gcd-0301m", "gcd-040101m", "gsc"]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_dialect_says_what_is_unverified_and_how_to_verify_it(name: str) -> None:
    dialect = load_dialect(name, device="stage1")
    assert dialect.unverified
    assert all(entry.unverified is True and entry.fact and entry.verify for entry in dialect.unverified)


@pytest.mark.parametrize("name", ["gcd-0301m", "gcd-040101m"])
def test_what_nobody_knows_of_a_gcd_box_has_no_default(name: str) -> None:
    facts = load_dialect(name, device="stage1").axis
    assert (facts.counts_per_mm, facts.speeds, facts.byte_order, facts.ramp_s) == (None, None, None, None)


def test_an_unknown_dialect_names_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="no stage dialect 'gcs'") as caught:
        load_dialect("gcs", device="stage1")
    assert "did you mean 'gsc'?" in caught.value.remedy
    assert caught.value.device == "stage1"


def test_a_file_that_is_not_there_is_said() -> None:
    with pytest.raises(ConfigurationError, match=r"mine\.yaml cannot be read"):
        load_dialect("/nowhere/mine.yaml", device="stage1")


@pytest.mark.parametrize(
    ("old", "new", "place", "remedy"),
    [
        (
            "motion: absolute",
            "motoin: absolute",
            "mine.yaml:7:1: unknown key 'motoin'",
            "did you mean 'motion'?",
        ),
        ("{baud: 9600,", "{buad: 9600,", "unknown key 'line.buad'", "did you mean 'baud'?"),
        ("  home:\n", "  homing:\n", "unknown key 'actions.homing'", "did you mean 'home'?"),
        ("limit_bytes: 64", "limit_bytes: many", "'replies.limit_bytes' is wrong", "correct"),
        ('accepted: "OK"', 'accepted: "(OK"', "no regular expression", "correct"),
        ("(?P<busy>[BR])", "[BR]", "lacks the group 'busy'", "correct"),
        ("D:{axis}S500F{speed}R200", "D:{axis}S500F{sped}R200", "unknown field 'sped'", "correct"),
        ('  refused: "NG"\n', "", "'replies.refused' is missing", "set replies.refused"),
        ("baud: 9600", "baud: yes", "line.baud", "correct"),
        ("title: OptoSigma", "title: &a OptoSigma", "anchors", "plain keys"),
        ("terminator:", "title: again\nterminator:", "duplicate key", "plain keys"),
        ("framing: text", "framing: [text", "mine.yaml", "plain keys"),
    ],
)
def test_a_wrong_dialect_says_where_and_what_is_accepted(
    tmp_path: Path, old: str, new: str, place: str, remedy: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_dialect(changed(tmp_path, old, new), device="stage1")
    assert "mine.yaml:" in caught.value.what
    assert place in caught.value.what
    assert remedy in caught.value.remedy


def test_a_binary_template_holds_bytes_in_hex(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no sequence of bytes"):
        load_dialect(changed(tmp_path, "00 00 40", "00 0 40", "gcd-040101m"), device="stage1")


@pytest.mark.parametrize("content", [b"a: " + b"[" * 5000, b"", b"- 1", b"a: b\n" * 50_000, b"\xff\xfe", b"a: \x00"])
def test_a_file_that_is_no_dialect_at_all_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError):
        load_dialect(str(path), device="stage1")
