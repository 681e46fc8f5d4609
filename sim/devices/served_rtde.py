"""A UR controller in real time around a simulated arm, client after client."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array
from sim.devices.rtde_controller import RtdeController
from sim.devices.served_arm import ANSWER_WITHIN, ServedArm, Session


class ServedRtde(ServedArm):
    """As ``ServedArm``, behind RTDE: ``address`` is where it listens. A client that leaves ends its session."""

    def sessions(self, most: int, done: Callable[[Session], None]) -> None:
        """See ``ServedArm.sessions``."""
        count = 0
        while not self._stopped and (most == 0 or count < most):
            self._controller = RtdeController(self.arm, timeout=ANSWER_WITHIN * self._host_T, port=self._address[1],
                                              after=self._carry_and_listen)
            self._due = time.perf_counter()
            self._controller.run()
            session = Session([np.array(row) for row in self._controller.commands],
                              len(self._controller.commands), ended="the client has left")
            if self._moved_by(session.commands):
                self._brake(session)
                done(session)
                self._go_back(session.commands[-1])
                count += 1
            elif session.commands:
                self._reset()

    def stop(self) -> None:
        """Ends ``sessions`` after the present cycle."""
        super().stop()
        self._controller.stop()

    def _carry_and_listen(self, k: int) -> None:
        self._carry(k)

    def _moved_by(self, commands: list[Array]) -> bool:
        return bool(commands) and bool(np.abs(np.array(commands) - self._start).max() > 1e-6)
