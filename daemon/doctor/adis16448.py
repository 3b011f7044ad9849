"""The ADIS16448: port, wires, self-test, settings, data-ready line, samples."""

from __future__ import annotations

from pathlib import Path

from daemon.doctor import lines, node, rest, sampling
from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, Verdict, fault, not_checked, ok, warning
from daemon.imu.ports import OpenLine, OpenPort, port_openers
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448, ChecksumMissing, ImuError
from drivers.adis16448.machine import POWER_ON_S, RESET_S, SELF_TEST_S
from drivers.adis16448.probe import IdKind, meaning_of_ids, product_ids
from drivers.clock import Clock
from drivers.spi import SpiError, SpiTransport

PORT, WHO, TEST, REGISTERS = "SPI port", "sensor", "self-test", "sensor settings"
LATER = (WHO, TEST, REGISTERS, lines.NAME, *sampling.NAMES)
_IDS = 32
_POLL_S, _TEST_LIMIT_S = 0.005, 1.0
_HINT = "`ramstroke doctor --scan-lines` watches the other lines of the chip"


def look(patient: Patient) -> list[Check]:
    """All checks of the part; those behind a fault that hides them are not made."""
    settings = patient.settings.imu
    wanted = _node(settings) if settings.transport == "spidev" else None
    if wanted is not None:
        bad = node.examine(wanted, patient.user)
        if bad is not None and not (patient.taken and "in use" in bad.found):
            return [bad, *_hidden()]
    if patient.taken:
        return [not_checked("inertial sensor", patient.taken, "stop the daemon to have it looked at")]
    if wanted is not None and (foreign := node.not_mine(wanted, patient.user, patient.me)) is not None:
        return [foreign, *_hidden()]
    open_port, open_line = port_openers(settings, patient.clock, patient.support)
    chip = lines.chip_of(settings)
    bad_line = None
    if chip is not None:
        bad_line = node.examine(chip, patient.user) or node.not_mine(chip, patient.user, patient.me)
    return examine(patient, open_port, open_line, bad_line)


def examine(
    patient: Patient, open_port: OpenPort, open_line: OpenLine | None, bad_line: Check | None = None
) -> list[Check]:
    """As `look`, of a part behind these ports; `bad_line`: why its line cannot be opened anyway."""
    settings, clock = patient.settings.imu, patient.clock
    patient.say("asking the sensor who it is")
    try:
        port = open_port()
    except SpiError as error:
        advice = "see `program` above, ls -l /dev/spidev*, and spi_device in [imu]"
        if settings.transport == "socket":
            advice = "start `ramstroke sim` with the same configuration, or correct socket_path in [imu]"
        return [fault(PORT, str(error), advice), *_hidden()]
    checks = [ok(PORT, f"{_name(settings)} opens; mode 3, 8-bit words, 1 MHz", speed_hz=1_000_000, mode=3)]
    try:
        device = Adis16448(port, clock, settings)
        for step in (_who, _self_test, _settings):
            check = step(device, clock)
            checks.append(check)
            if check.verdict is Verdict.FAULT and step is not _self_test:
                return checks + _hidden(after=len(checks) - 1)
        patient.say("driving the data-ready pin")
        others = lines.other_lines(settings) if patient.scan_lines and settings.transport == "spidev" else ()
        hint = _HINT if settings.transport == "spidev" and not patient.scan_lines else ""
        checks.append(bad_line or lines.examine(device, clock, open_line, others, hint))
        line_works = checks[-1].verdict in (Verdict.OK, Verdict.WARNING)
        patient.say(f"reading samples for {patient.listen_s:g} s")
        # The driver itself reads them: what is judged is what the daemon would get.
        read = sampling.read(settings, clock, lambda: _Kept(port), open_line if line_works else None, patient.listen_s)
        return (
            checks
            + sampling.examine(read, settings)
            + rest.examine(read.good, rest.adis16448(settings), patient.settings.mount, "mount", "")
        )
    except (SpiError, ImuError) as error:
        return [*checks, fault("SPI transfers", str(error), _advice(error)), *_hidden(after=len(checks) - 1)]
    finally:
        port.close()


def _who(device: Adis16448, clock: Clock) -> Check:
    device.reset()
    clock.sleep(RESET_S)
    readings = product_ids(device, _IDS)
    if meaning_of_ids(readings).kind is not IdKind.RIGHT:
        clock.sleep(POWER_ON_S)  # it may have been waking
        readings = product_ids(device, _IDS)
    meaning = meaning_of_ids(readings)
    figures = {"reads": str(meaning.kind), "readings": len(readings), "wrong": sum(v != 0x4040 for v in readings)}
    if meaning.kind is not IdKind.RIGHT:
        return fault(WHO, meaning.what, meaning.advice, **figures)
    try:
        who = device.identify()
    except ImuError as error:
        return fault(WHO, error.what, error.advice, **figures)
    return ok(WHO, f"{who.name}; {meaning.what}", serial=who.serial, lot=f"{who.lot_id:08X}", **figures)


def _self_test(device: Adis16448, clock: Clock) -> Check:
    duration_s = SELF_TEST_S * (1 << device.settings.decimation_exponent)
    limit_ns = clock.now_ns() + round((duration_s + _TEST_LIMIT_S) * 1e9)
    device.begin_self_test()
    clock.sleep(duration_s)
    try:
        while (notes := device.self_test_verdict()) is None:
            if clock.now_ns() > limit_ns:
                return fault(TEST, "the self-test does not end", "switch its supply off and on; then replace it")
            clock.sleep(_POLL_S)
    except ImuError as error:
        advice = "let the support rest and run doctor again; if it fails again, replace the sensor"
        return fault(TEST, error.what, advice)
    if notes:
        return ok(TEST, f"passed; {' and '.join(notes)}, which nothing here needs", notes=notes)
    return ok(TEST, "passed: gyroscopes, accelerometers, memory")


def _settings(device: Adis16448, _: Clock) -> Check:
    try:
        notes = device.configure()
    except ChecksumMissing as error:
        return warning(REGISTERS, error.what, error.advice, burst_checksum=False)
    except ImuError as error:
        return fault(REGISTERS, error.what, error.advice or "check the wires DIN (MOSI) and SCLK")
    words = "written and read back"
    if device.crc_active:
        return ok(REGISTERS, f"{words}; bursts carry a checksum", burst_checksum=True)
    return ok(REGISTERS, "; ".join([words, *notes]), burst_checksum=False)


class _Kept:
    """A port that outlives whoever reads through it."""

    def __init__(self, port: SpiTransport) -> None:
        self._port = port

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        """One frame."""
        return self._port.transfer(data, speed_hz)

    def close(self) -> None:
        """It is closed by who opened it."""


def _node(settings: ImuSettings) -> node.Node:
    switch_on = "switch SPI on (Raspberry Pi: dtparam=spi=on in /boot/firmware/config.txt) and restart the computer"
    chip = lines.chip_of(settings)
    companions = () if chip is None else (chip.path,)
    device = Path(settings.spi_device)
    return node.Node(PORT, device, "spi_device in [imu]", switch_on, "spidev*", companions=companions)


def _name(settings: ImuSettings) -> str:
    if settings.transport == "spidev":
        return settings.spi_device
    return f"the virtual sensor at {settings.socket_path}" if settings.transport == "socket" else "the virtual sensor"


def _advice(error: OSError | ImuError) -> str:
    if isinstance(error, ImuError):
        return error.advice or "check the sensor's wires"
    return (
        "no wire of the sensor does that: see what dmesg tells of this computer's SPI driver, and restart the computer"
    )


def _hidden(after: int = 0) -> list[Check]:
    """The checks that cannot be made because one before them found a fault; so many behind the port were made."""
    advice = "mend what stands above, then run doctor again"
    return [not_checked(name, "it needs what stands above", advice) for name in LATER[after:]]
