"""The SPI port: one chip-select-low frame at a time, nothing more."""

from __future__ import annotations

from typing import Any, Protocol


class SpiError(OSError):
    """The SPI port cannot be opened or a transfer failed; the text is one sentence for a person."""


class SpiTransport(Protocol):
    """Whatever can carry SPI frames: the kernel's port, a socket, or the virtual part itself."""

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        """Send `data` in one chip-select-low frame; return as many bytes received meanwhile.

        Raises SpiError.
        """

    def close(self) -> None:
        """Release the port."""


class SpidevTransport:
    """An SPI port of the Linux kernel: mode 3, and 8-bit words, whose wave form is that of 16-bit ones."""

    def __init__(self, device: str = "/dev/spidev0.0") -> None:
        try:
            import spidev
        except ImportError:
            raise SpiError(
                f"cannot use {device}: the Python module spidev is missing, install ramstroke[hardware]"
            ) from None
        self._device = device
        self._port: Any = spidev.SpiDev()
        try:
            self._port.open_path(device)
            self._port.mode = 3
            self._port.bits_per_word = 8
        except FileNotFoundError:
            raise SpiError(
                f"there is no SPI port {device}: enable SPI on this computer or set spi_device in [imu]"
            ) from None
        except PermissionError:
            raise SpiError(
                f"no permission to open the SPI port {device}: run as a member of the group that owns it"
            ) from None
        except OSError as error:
            self._port.close()
            raise SpiError(f"cannot open the SPI port {device}: {error}") from error

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        """Exchange one frame. xfer2 keeps chip select low throughout and releases the GIL meanwhile."""
        try:
            return bytes(self._port.xfer2(list(data), speed_hz))
        except OSError as error:
            raise SpiError(f"the SPI transfer on {self._device} failed: {error}") from error

    def close(self) -> None:
        """Close the port."""
        self._port.close()
