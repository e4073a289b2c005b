"""``groundstation install udev``: the rule that lets users read the bridge."""

import pytest

from groundstation.cli import install
from groundstation.errors import GroundStationError
from support.daemons import in_process, require_failure


def test_the_rule_names_the_configured_device(tmp_path):
    usual = in_process("install", "udev", "--print")
    assert usual.returncode == 0
    assert 'ATTR{idVendor}=="1915", ATTR{idProduct}=="7777"' in usual.stdout  # a Crazyradio
    assert 'ATTR{idVendor}=="0483", ATTR{idProduct}=="5741"' in usual.stdout
    config = tmp_path / "station.toml"
    config.write_text('[usb]\ndevice = "1209:00AF"\n')
    other = in_process("install", "udev", "--print", "--config", config)
    assert 'ATTR{idVendor}=="1209", ATTR{idProduct}=="00af"' in other.stdout


def test_a_wrong_device_in_the_configuration_is_refused(tmp_path):
    config = tmp_path / "station.toml"
    config.write_text('[usb]\ndevice = "bridge"\n')
    line = require_failure(in_process("install", "udev", "--print", "--config", config))
    assert "bridge" in line


def test_the_rule_is_written_where_udev_looks_or_the_way_to_do_it_is_told(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(install, "RULE_FILE", tmp_path / "70-groundstation.rules")
    install.udev(config=None, show=False)
    assert (tmp_path / "70-groundstation.rules").read_text() == install.udev_rule(0x0483, 0x5741)
    assert "udevadm control --reload" in capsys.readouterr().out
    monkeypatch.setattr(install, "RULE_FILE", tmp_path / "absent" / "70-groundstation.rules")
    with pytest.raises(GroundStationError, match="sudo tee"):
        install.udev(config=None, show=False)
