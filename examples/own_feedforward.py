"""A feedforward of your own beside the built-in ones in one comparison table."""

from ideal_robot.feedforward.base import Feedforward
from scenes import compare_scene, load_scene


class OneCycleAhead(Feedforward):
    """Commands where the arm shall be one cycle later."""

    n_d, t_ipo = 2, 0.012
    init = staticmethod(lambda q0: None)
    step = staticmethod(lambda state, q_d, tau_ext_d=None: (q_d[1], state))


comparison = compare_scene(load_scene("line"), methods=["none", "sensor_path", OneCycleAhead(), "ideal"])
for method, mean, *_ in comparison.table()[1]:
    print(f"{method}: mean {mean:.3f} mm")
