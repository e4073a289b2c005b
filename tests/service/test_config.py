from pathlib import Path

import pytest

from groundstation.errors import BadInputError
from groundstation.service.config import (
    Config,
    ConfigSource,
    link_speed,
    load_config,
    settings,
    socket_path,
)


def written(tmp_path, text):
    path = tmp_path / "station.toml"
    path.write_text(text)
    return path


def test_without_a_file_there_are_defaults_that_need_no_hardware():
    config = load_config(None)
    assert config == Config()
    assert config.link.name == "stand-in"
    assert config.recording.enabled
    assert config.viewer.mode == "off"


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path):
    config = load_config(
        written(
            tmp_path,
            "vehicle = 'crazyflie21'\n[link]\nspeed = 'max'\n[recording]\nfolder = '/data'\n"
            "[stand_in]\nseed = 7\neffects = {gyro_bias = {x = 0.1}}\n",
        )
    )
    assert config.vehicle == "crazyflie21"
    assert config.link.name == "stand-in"
    assert link_speed(config.link.speed) == float("inf")
    assert config.recording.folder == "/data"
    assert config.recording.enabled
    assert config.stand_in == {"seed": 7, "effects": {"gyro_bias": {"x": 0.1}}}


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("[recording]\nfoldr = 'x'\n", "foldr"),
        ("[link]\nspeed = 'fast'\n", "link.speed"),
        ("[viewer]\nport = 'web'\n", "viewer.port"),
        ("[viewer\n", "station.toml"),
        ("\udcff", "station.toml"),
    ],
)
def test_a_mistake_is_told_in_one_line_with_the_file_and_the_key(tmp_path, text, mentions):
    path = tmp_path / "station.toml"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(BadInputError) as refused:
        load_config(path)
    assert str(path) in str(refused.value)
    assert mentions in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BadInputError, match=r"nowhere\.toml: No such file"):
        load_config(tmp_path / "nowhere.toml")


def test_the_socket_is_the_configured_one_then_the_environments_then_the_users(monkeypatch):
    monkeypatch.setenv("GROUNDSTATION_SOCKET", "/run/env.sock")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/1000")
    assert socket_path("/run/configured.sock") == Path("/run/configured.sock")
    assert socket_path() == Path("/run/env.sock")
    monkeypatch.delenv("GROUNDSTATION_SOCKET")
    assert socket_path() == Path("/run/user/1000/groundstation/control.sock")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert socket_path().name == "control.sock"
    assert str(socket_path()).count("groundstation-") == 1


@pytest.mark.parametrize("way", ["file", "environment"])
def test_a_table_of_the_first_version_is_read_with_a_warning_that_says_its_name_of_today(
    tmp_path, capsys, way
):
    if way == "file":
        source = ConfigSource(written(tmp_path, "[dead_man]\nlevel_s = 0.3\n"), {}, {})
    else:
        source = ConfigSource(environment={"GROUNDSTATION_DEAD_MAN_LEVEL_S": "0.3"})
    assert source.load().failsafe.level_s == 0.3
    (warned,) = capsys.readouterr().err.splitlines()
    assert "is called failsafe" in warned
    assert "2.0" in warned


def test_a_table_under_both_its_names_is_refused(tmp_path):
    path = written(tmp_path, "[dead_man]\nlevel_s = 0.3\n[failsafe]\nstop_s = 1.0\n")
    with pytest.raises(BadInputError, match="keep one"):
        load_config(path)


def test_every_key_is_explained():
    assert [one.name for one in settings(Config()) if not one.text] == []


def test_the_environment_overrides_the_file_and_the_command_line_both(tmp_path):
    path = written(tmp_path, "[viewer]\nport = 1111\nweb_port = 2222\n[link]\nspeed = 3.0\n")
    environment = {
        "GROUNDSTATION_VIEWER_PORT": "3333",
        "GROUNDSTATION_VIEWER_WEB_PORT": "4444",
        "GROUNDSTATION_RECORDING_ENABLED": "false",
        "GROUNDSTATION_LOCAL_DATA": "of somebody else",
    }
    config = ConfigSource(path, {"viewer.port": 5555}, environment).load()
    assert (config.viewer.port, config.viewer.web_port) == (5555, 4444)
    assert config.link.speed == 3.0
    assert not config.recording.enabled


def test_a_mistake_in_the_environment_names_the_variable_and_the_key():
    source = ConfigSource(environment={"GROUNDSTATION_VIEWER_PORT": "web"})
    with pytest.raises(BadInputError, match=r"GROUNDSTATION_VIEWER_PORT: .*viewer\.port"):
        source.load()


def test_a_key_of_an_earlier_version_is_refused_with_what_does_its_work_now(tmp_path):
    in_a_file = ConfigSource(written(tmp_path, "[control]\ntcp_port = 8000\n"), {}, {})
    for source in (in_a_file, ConfigSource(environment={"GROUNDSTATION_CONTROL_TCP_PORT": "1"})):
        with pytest.raises(BadInputError, match=r"control\.tcp_port is no key any more: .*ssh"):
            source.load()
