"""What travels with the package when it is installed as a wheel."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import vergence
from vergence.twin.profile import shipped

ROOT = Path(__file__).parents[1]


def test_every_public_name_is_there():
    assert [name for name in vergence.__all__ if not hasattr(vergence, name)] == []


@pytest.mark.slow
def test_the_wheel_carries_model_profiles_types_and_version(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", str(tmp_path)]
    done = subprocess.run([*command, str(ROOT)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("vergence-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    scenes = {f"vergence/models/{name}/scene.xml" for name in ("cbi_head", "shared_tilt_head")}
    assets = {f"vergence/{p.relative_to(ROOT)}" for p in (ROOT / "models").rglob("assets/*.png")}
    profiles = {f"vergence/twin/profiles/{name}.toml" for name in shipped()}
    assert {*scenes, *assets, *profiles, "vergence/py.typed"} <= names
    assert wheel.name.startswith(f"vergence-{vergence.__version__}-")
