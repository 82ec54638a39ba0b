import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked}:
            raise ImportError(name + " is not on the robot")

sys.meta_path.insert(0, Refuse())
import hardware.control, hardware.log, hardware.virtual, hardware.robot, hardware.safety, hardware.bus, hardware.j60
import sim.actor, sim.observation
print(sorted(name for name in sys.modules if name.partition(".")[0] in {ours}))
"""
HEAVY = {"torch", "mujoco", "manifold3d", "scipy", "skimage", "trimesh", "matplotlib", "sklearn", "pandas", "cma"}


def test_the_robots_side_needs_only_numpy_and_python_can() -> None:
    program = PROGRAM.format(blocked=HEAVY, ours={"sim", "mfg", "decoder", "evo", "analysis", "experiments"})
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "['sim', 'sim.actor', 'sim.observation']"
