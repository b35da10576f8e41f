"""How a cell is simulated: who is there, rates, noise."""

from __future__ import annotations

from dataclasses import dataclass

from handover_ros.errors import BadModelError

PERSON_RATE = 100.0  # [Hz] of the person's decisions
SLOWEST_PHYSICS, FASTEST_PHYSICS = 300.0, 2000.0  # [Hz]


@dataclass(frozen=True)
class SimulationOptions:
    """How the cell is simulated.

    Attributes:
        robot: Name of the robot; empty: the scene's.
        person: Name of the person; empty: the scene's, ``none``: nobody.
        physics_rate: Physics steps a second [Hz], a multiple of 100.
        mocap_rate: Marker frames a second [Hz], 50 to 480.
        marker_noise: Standard deviation of a marker's position along each axis [m].
        occlusion_fraction: Share of samples lost at random, besides those that no two cameras see.
        start_time: What the simulation's clock shows at the start [s].
    """

    robot: str = ""
    person: str = ""
    physics_rate: float = 500.0
    mocap_rate: float = 240.0
    marker_noise: float = 0.0005
    occlusion_fraction: float = 0.0
    start_time: float = 0.0

    def __post_init__(self) -> None:
        """Check the physics rate; the other values are checked by those who use them.

        Raises:
            BadModelError: It is out of range or no multiple of the rate of the person's decisions.
        """
        rate = self.physics_rate
        if not SLOWEST_PHYSICS <= rate <= FASTEST_PHYSICS or rate % PERSON_RATE != 0.0:
            raise BadModelError(
                f"physics_rate {rate} Hz: must be a multiple of {PERSON_RATE:g} "
                f"from {SLOWEST_PHYSICS:g} to {FASTEST_PHYSICS:g}"
            )
