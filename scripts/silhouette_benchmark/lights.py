"""The lights that are asked for: random ones, and a sun that moves."""

from __future__ import annotations

import numpy as np

from svprep.model import F32


def random_lights(positions: F32, n: int, seed: int) -> list[F32]:
    """Return `n` lights around a mesh, in turn directional and point lights.

    Directions are spread evenly over the whole sphere, above and below the horizon.
    Point lights lie in such directions from the middle of the mesh, at 0.1 to 10
    times its radius, evenly in the logarithm: some are among the objects.
    """
    generator = np.random.default_rng(seed)
    low, high = positions.min(axis=0), positions.max(axis=0)
    middle = (low.astype(np.float64) + high) / 2.0
    radius = float(np.linalg.norm(high.astype(np.float64) - low)) / 2.0
    lights = []
    for number in range(n):
        toward = generator.normal(size=3)
        toward /= np.linalg.norm(toward)
        distance = radius * 10.0 ** generator.uniform(-1.0, 1.0)
        is_point = number % 2
        place = middle + distance * toward if is_point else toward
        lights.append(np.array([*place, is_point], np.float32))
    return lights


def sun_hour(minutes: int = 60) -> list[F32]:
    """Return the sun from nine o'clock on, a direction a minute.

    At latitude 48 degrees and declination 20 degrees: only its slow motion matters.
    """
    latitude, declination = np.radians([48.0, 20.0])
    lights = []
    for minute in range(minutes):
        hour_angle = np.radians(15.0 * (9.0 + minute / 60.0 - 12.0))
        east = -np.cos(declination) * np.sin(hour_angle)
        toward_pole, along = np.sin(declination), np.cos(declination) * np.cos(hour_angle)
        north = np.cos(latitude) * toward_pole - np.sin(latitude) * along
        up = np.sin(latitude) * toward_pole + np.cos(latitude) * along
        lights.append(np.array([east, north, up, 0.0], np.float32))
    return lights
