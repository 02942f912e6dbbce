"""Units of derivatives and quotients, as text."""

_RAISED = {1: "", 2: "²", 3: "³", 4: "⁴"}


def derivative_unit(unit: str | None, order: int) -> str:
    """The unit of a time derivative: m/s² for m and order 2, or m/s and order 1; "" for none."""
    if not unit:
        return ""
    present = next((n for n, raised in _RAISED.items() if unit.endswith(f"/s{raised}")), 0)
    order += present
    base = unit.removesuffix(f"/s{_RAISED[present]}") if present else unit
    return f"{base}/s{_RAISED.get(order, f'^{order}')}" if order else unit


def quotient_unit(unit: str, divisor: str) -> str:
    """Quotient of two units: a power of 1/s if `unit` is a derivative of `divisor`; "" for none."""
    if not unit or not divisor:
        return ""
    orders = (n for n in range(5) if derivative_unit(divisor, n) == unit)
    plain = f"{unit}/({divisor})" if "/" in divisor else f"{unit}/{divisor}"
    return next((derivative_unit("1", n) for n in orders), plain)
