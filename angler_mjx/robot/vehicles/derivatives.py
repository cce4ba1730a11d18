"""Names of derivatives of the wrench by products of two velocities, such as Y_uv."""

from angler_kernels.cross_damping import PRODUCT_PAIRS

_FORCES, _VELOCITIES = "XYZKMN", "uvwpqr"


def read_product(name: str) -> tuple[int, int]:
    """Return row and column of a derivative such as ``Y_uv`` in ``CrossDamping.products``.

    Raises:
        ValueError: the name is none of a force and two velocities.
    """
    force, _, pair = name.partition("_")
    is_force = len(force) == 1 and force in _FORCES
    if not is_force or len(pair) != 2 or any(letter not in _VELOCITIES for letter in pair):
        raise ValueError(
            f"products.{name}: a derivative is a force of {_FORCES} and two velocities of "
            f"{_VELOCITIES}, such as Y_uv"
        )
    j, k = sorted(_VELOCITIES.index(letter) for letter in pair)
    return _FORCES.index(force), PRODUCT_PAIRS.index((j, k))
