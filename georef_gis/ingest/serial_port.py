"""Serial ports: which there are, opening one with a message that cures, and finding it again."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from georef_gis.errors import InputError

# Bd; what the boards and recorders of the field speak, the likeliest first
BAUD_RATES = (115200, 57600, 38400, 9600, 19200, 230400, 4800, 460800, 921600)
# bytes taken from the driver at once
_MOST_BYTES = 65536


class PortLostError(InputError):
    """The port vanished while it was in use: unplugged, or its power is gone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PortInfo:
    """What the system says of a port; empty or None where it says nothing.

    Parameters
    ----------
    device
        Name to open, e.g. ``/dev/ttyUSB0`` or ``COM4``.
    serial_number
        Of the USB adapter: it stays when the name changes.
    location
        USB socket.
    vid, pid
        Maker and product of the USB adapter.
    """

    device: str
    description: str = ""
    manufacturer: str = ""
    serial_number: str = ""
    location: str = ""
    vid: int | None = None
    pid: int | None = None

    @property
    def is_usb(self) -> bool:
        """Whether it is a USB adapter."""
        return self.vid is not None

    def line(self) -> str:
        """One line for people."""
        usb = f" USB {self.vid:04x}:{self.pid or 0:04x}" if self.vid is not None else ""
        number = f" serial number {self.serial_number}" if self.serial_number else ""
        return f"{self.device}  {self.description or 'no description'}{usb}{number}"


def _pyserial() -> ModuleType:
    try:
        import serial
    except ImportError as error:
        raise InputError("a serial port needs pyserial; pip install georef-gis[logs]") from error
    return serial  # type: ignore[no-any-return]


def list_ports() -> tuple[PortInfo, ...]:
    """Serial ports of this computer: USB adapters first, then by name."""
    _pyserial()
    from serial.tools.list_ports import comports

    found = [
        PortInfo(
            device=str(port.device),
            description="" if port.description in (None, "n/a") else str(port.description),
            manufacturer=port.manufacturer or "",
            serial_number=port.serial_number or "",
            location=port.location or "",
            vid=port.vid,
            pid=port.pid,
        )
        for port in comports()
    ]
    return tuple(sorted(found, key=lambda port: (not port.is_usb, port.device)))


def port_info(device: str) -> PortInfo:
    """What the system says of a device; a link such as ``/dev/serial/by-id/...`` is followed."""
    real = os.path.realpath(device)
    for port in list_ports():
        if port.device in (device, real):
            return port
    return PortInfo(device=device)


def find_again(lost: PortInfo, asked: str, ports: Iterable[PortInfo]) -> str | None:
    """Device under which a lost port is there again, or None.

    Parameters
    ----------
    lost
        The port as it was.
    asked
        The name that the user gave.
    ports
        What is there now.

    Notes
    -----
    By the serial number of the USB adapter; without one, by its kind and socket; without USB, by
    its name. Another adapter that got the old name is not taken for it.
    """
    ports = tuple(ports)
    same_kind = [p for p in ports if p.is_usb and (p.vid, p.pid) == (lost.vid, lost.pid)]
    if lost.serial_number:
        return next((p.device for p in same_kind if p.serial_number == lost.serial_number), None)
    if lost.is_usb:
        at_socket = [p for p in same_kind if p.location == lost.location]
        found = at_socket or (same_kind if len(same_kind) == 1 else [])
        return found[0].device if found else None
    named = [port.device for port in ports if port.device in (asked, lost.device)]
    if named:
        return named[0]
    return asked if os.path.exists(asked) else None


class SerialPort:
    """An open port, 8 bits, no parity, one stop bit, no flow control."""

    def __init__(self, handle: Any, device: str, baud: int) -> None:
        self._handle = handle
        self.device = device
        self.baud = baud

    def read(self) -> bytes:
        """Bytes that came; waits a fifth of a second for the first.

        Raises
        ------
        PortLostError
            If the port is gone.
        """
        try:
            first: bytes = self._handle.read(1)
            if not first:
                return b""
            more: bytes = self._handle.read(min(self._handle.in_waiting, _MOST_BYTES))
        except (OSError, TypeError) as error:
            # A handle that another thread closes gives a TypeError.
            raise self._lost(error) from error
        return first + more

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises
        ------
        PortLostError
            If the port is gone or takes nothing for two seconds.
        """
        try:
            self._handle.write(data)
        except (OSError, TypeError) as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """Close it; a port that is gone may not close well, which does not matter."""
        with contextlib.suppress(OSError, TypeError):
            self._handle.close()

    def _lost(self, error: Exception) -> PortLostError:
        text = "takes no bytes" if "timeout" in str(error).lower() else "is gone"
        return PortLostError(f"the port {text}; look at cable and power", source=self.device)


def open_port(device: str, baud: int = BAUD_RATES[0]) -> SerialPort:
    """Open a port for this program alone.

    Parameters
    ----------
    device
        Name of the port, or a URL of pyserial such as ``socket://host:port``.
    baud : Bd

    Raises
    ------
    InputError
        If there is no such port, it is in use, or it must not be opened; the message says which.
    """
    serial = _pyserial()
    # A second reader would steal bytes from the first, silently.
    alone = {"exclusive": True} if os.name == "posix" and "://" not in device else {}
    try:
        handle = serial.serial_for_url(
            device, baudrate=baud, timeout=0.2, write_timeout=2.0, **alone
        )
    except (OSError, ValueError) as error:
        raise InputError(_why_not(device, baud, error), source=device) from error
    return SerialPort(handle, device, baud)


def _why_not(device: str, baud: int, error: Exception) -> str:
    """Say why a port does not open, and what to do."""
    number, text = getattr(error, "errno", None), str(error)
    if number in (errno.EACCES, errno.EPERM):
        return (
            "no permission to open the port; add yourself to its group (Linux: sudo usermod -aG "
            "dialout $USER, then log in again), or it is in use by another program (Windows)"
        )
    busy = (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK)
    if number in busy or "exclusively lock" in text or "PermissionError" in text:
        return "the port is in use by another program; end that one first"
    if "baud" in text.lower():
        rates = ", ".join(map(str, BAUD_RATES))
        return f"{baud} Bd is not possible on this port; use one of {rates}"
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "FileNotFoundError" in text:
        there = ", ".join(port.device for port in list_ports()) or "none"
        return f"there is no such port; ports found: {there}; plug the board in, or name another"
    if number in (errno.ENOTTY, errno.EINVAL) or f"({errno.ENOTTY}," in text:
        return "is no serial port; `georef sync-board list-ports` shows those there are"
    return f"cannot be opened ({' '.join(text.split())[:120]}); see `georef sync-board list-ports`"
