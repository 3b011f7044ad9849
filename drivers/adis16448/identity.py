"""Who an ADIS16448 says it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True, frozen=True)
class Identity:
    """Product, lot and serial number of the part that answers from `t_ns` on."""

    t_ns: int
    product_id: int
    lot_id: int  # LOT_ID1 in the upper half
    serial: int

    @property
    def name(self) -> str:
        """The part in words."""
        return f"ADIS16448 lot {self.lot_id:08X} serial {self.serial}"

    @property
    def facts(self) -> dict[str, float]:
        """What health tells of the part."""
        return {"serial": self.serial}

    def is_same_part(self, other: object) -> bool:
        """Whether both name one and the same part."""
        return isinstance(other, Identity) and (self.lot_id, self.serial) == (other.lot_id, other.serial)
