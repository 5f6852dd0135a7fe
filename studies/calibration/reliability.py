"""Whether a fit's intervals are reliable: they hold only if the model is right but for its factors."""

import numpy as np

from fabdesign.sensor_noise import SensorNoise
from fabdesign.surface import CAP
from fabdesign.units import in_mm

EXCESS = 0.0005  # m over the noise that a right model may leave
OUTLYING = 0.03  # share of frames far off from which on it is said


def noise_rms(noise: SensorNoise) -> float:
    """m, RMS of capped distances of points that lie on the surface but for the sensor's noise and strays."""
    reach = max(noise.stray_reach, 1e-12)
    inner = min(reach, CAP)  # strays are even over the reach
    stray = (inner**3 / 3 + (reach - inner) * CAP**2) / reach
    return float(np.sqrt((1 - noise.strays) * noise.sigma**2 + noise.strays * stray))


def excess(rms: float, noise: SensorNoise) -> float:
    """m: what a capped RMS `rms` [m] has over the noise, in quadrature."""
    return float(np.sqrt(max(rms**2 - noise_rms(noise) ** 2, 0.0)))


def interval_warnings(rms: float, outlying: float, noise: SensorNoise) -> list[str]:
    """Why the intervals of a fit that leaves `rms` [m] and a share of frames far off are not reliable."""
    warnings = []
    if not (left := excess(rms, noise)) <= EXCESS:
        warnings.append(f"the fit leaves {in_mm(left):.2f} mm over the noise, expected at most {in_mm(EXCESS):g}")
    if outlying >= OUTLYING:
        warnings.append(f"{outlying:.0%} of the frames fitted are far off, expected under {OUTLYING:.0%}")
    return warnings
