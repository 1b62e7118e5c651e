from pathlib import Path

import pytest

from irpmd_rig.service.token import TokenError, read_token


def test_a_token_is_made_once_for_its_owner_alone(tmp_path: Path) -> None:
    token = read_token(tmp_path)
    assert len(token) >= 40
    assert [path.name for path in tmp_path.iterdir()] == ["token"]
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
    assert read_token(tmp_path) == token


def test_tokens_differ(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    assert read_token(tmp_path) != read_token(tmp_path / "other")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o666])
def test_a_token_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    read_token(tmp_path)
    (tmp_path / "token").chmod(mode)
    with pytest.raises(TokenError, match="can be read by others"):
        read_token(tmp_path)


@pytest.mark.parametrize("content", [b"", b"short\n", b"\xff" * 40, b"a b" * 20])
def test_a_file_without_a_token_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "token").write_bytes(content)
    (tmp_path / "token").chmod(0o600)
    with pytest.raises(TokenError, match="holds no token"):
        read_token(tmp_path)


def test_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "token").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(TokenError, match="cannot be read"):
        read_token(tmp_path)
    assert not (tmp_path / "elsewhere").exists()
