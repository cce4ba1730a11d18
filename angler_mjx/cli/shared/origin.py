"""Position of the origin of the world, as commands take it."""

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.frames import GeodeticOrigin


def parse_origin(text: str) -> GeodeticOrigin:
    """Parse latitude and longitude, and an altitude if there is one.

    Raises:
        ConfigError: the text has another form, or is not on the globe.
    """
    advice = "write LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,ALTITUDE, as in 47.6,-122.3"
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise ConfigError(f"--origin {format_value(text)}: {advice}")
    latitude, longitude, *rest = numbers
    altitude = rest[0] if rest else 0.0
    if not (abs(latitude) < 90 and abs(longitude) <= 180 and abs(altitude) <= 1e4):
        raise ConfigError(f"--origin {format_value(text)}: is not on the globe; {advice}")
    return GeodeticOrigin(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude)
