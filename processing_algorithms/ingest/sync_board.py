"""Tools of the time-synchronisation board: record, list-ports, send, simulate, decode."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import InputError
from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.ingest.pwm_index import PwmIndex
    from georef_gis.ingest.sync_board_recorder import Recorder, Recording

# s between two looks at the recorder, between two lines where no bar is shown
_LOOK_EVERY, _LINE_EVERY = 0.25, 60.0


def _ports() -> list[str]:
    """Lines on the ports there are."""
    from georef_gis.ingest.serial_port import list_ports

    return [port.line() for port in list_ports()]


class ListPortsParameters(p.Parameters):
    """Parameters of `sync_board_list_ports`: none."""


class ListPorts(Algorithm[ListPortsParameters]):
    """List the serial ports of this computer.

    With the serial number of USB adapters, by which `georef sync-board record` finds its port
    again after unplugging.
    """

    id, name, group = "sync_board_list_ports", "Serial ports", "ingest"
    command = ("sync-board", "list-ports")
    needs_project = False

    def run(self, context: Context, parameters: ListPortsParameters, feedback: Feedback) -> Result:
        """List them."""
        ports = _ports()
        if not ports:
            feedback.info("no serial port; is the adapter plugged in?")
        return Result(summary={f"port_{number}": line for number, line in enumerate(ports, 1)})


class RecordParameters(p.Parameters):
    """Parameters of `sync_board_record`."""

    port: p.Text = p.text("", title="Serial port, e.g. /dev/ttyUSB0 or COM4", positional=True)
    output: p.File = p.file(
        Path("sync_board.log"), title="Log", writes=True,
        help="A log that is there is not touched: the new one gets a number; the raw bytes go "
        "beside it as .raw",
    )  # fmt: skip
    baud: p.Integer = p.integer(115200, title="Baud rate", unit="Bd", ge=300, le=4_000_000)
    duration: p.Number | None = p.number(
        None, title="Time after which to end", unit="s", gt=0, help="Else until Ctrl-C"
    )
    interval: p.Number | None = p.number(
        None, title="Interval to tell the board at every connection", unit="s", ge=0, le=3600
    )
    silence: p.Number = p.number(
        10.0, title="Silence that is told", unit="s", ge=1, le=3600, advanced=True
    )
    list_ports: p.Flag = p.flag(False, title="List the serial ports and end")


class Record(Algorithm[RecordParameters]):
    """Record a time-synchronisation board from a serial port, until Ctrl-C.

    Good lines go to the log at once, every byte goes to the raw capture beside it. An unplugged
    port is waited for; damaged lines, gaps of the counter, silence and a wrong baud rate are told.
    """

    id, name, group = "sync_board_record", "Record the sync board", "ingest"
    command = ("sync-board", "record")
    needs_project = False
    outputs = (
        Output(name="log", title="Lines of the board"),
        Output(name="raw", title="Every byte that came"),
    )

    def run(self, context: Context, parameters: RecordParameters, feedback: Feedback) -> Result:
        """Record."""
        from georef_gis.ingest.sync_board_files import free_names
        from georef_gis.ingest.sync_board_recorder import Recorder, RecorderSettings

        if parameters.list_ports:
            return ListPorts().run(context, ListPortsParameters(), feedback)
        if not parameters.port:
            there = "; ".join(_ports()) or "none"
            raise InputError(f"name a port; found: {there}", field="PORT")
        log, raw = free_names(parameters.output)
        settings = RecorderSettings(
            port=parameters.port, log=log, raw=raw, baud=parameters.baud,
            silence=parameters.silence, interval=parameters.interval,
        )  # fmt: skip
        recorder = Recorder(settings, feedback.info)
        recorder.start()
        feedback.info(f"recording {parameters.port} at {parameters.baud} Bd to {log}; Ctrl-C ends")
        state = _until_stopped(recorder, parameters.duration, feedback)
        return Result(
            outputs={"log": log, "raw": raw}, summary=_summary(state, parameters.baud, [log, raw])
        )


def _until_stopped(recorder: Recorder, duration: float | None, feedback: Feedback) -> Recording:
    """Show the state until the time is over or the user has enough; then all is on disk."""
    started = told = time.monotonic()
    try:
        while not feedback.cancelled():
            state = recorder.poll()
            now = time.monotonic()
            if duration is not None and now - started >= duration:
                break
            feedback.progress((now - started) / duration if duration else 0.0, state.line())
            if now - told >= _LINE_EVERY:
                told = now
                feedback.info(state.line())
            time.sleep(_LOOK_EVERY)
    except KeyboardInterrupt:
        # The usual end of a recording, not an abort.
        pass
    finally:
        ended = recorder.stop()
    return ended


def _summary(state: Recording, baud: int, products: list[Path]) -> dict[str, object]:
    return {
        "products": [str(path) for path in products],
        "triggers": state.triggers,
        "last_trigger": state.last_time(),
        "bytes": state.bytes_read,
        "lost_triggers": state.sequence.lost,
        "damaged_lines": state.framer.frames["damaged"],
        "interruptions": state.interruptions,
        "doubts": state.doubts(baud),
    }


class SendParameters(p.Parameters):
    """Parameters of `sync_board_send`."""

    port: p.Text = p.text(title="Serial port", positional=True)
    interval: p.Number | None = p.number(
        None, title="Interval between photos; 0 = none", unit="s", ge=0, le=3600
    )
    focus: p.Flag = p.flag(False, title="Let the camera focus")
    shutter: p.Flag = p.flag(False, title="Take one photo")
    baud: p.Integer = p.integer(115200, title="Baud rate", unit="Bd", ge=300, le=4_000_000)
    timeout: p.Number = p.number(
        1.0, title="Wait for an answer", unit="s", gt=0, le=60, advanced=True
    )
    attempts: p.Integer = p.integer(3, title="Times to try", ge=1, le=20, advanced=True)


class Send(Algorithm[SendParameters]):
    """Send a command to the time-synchronisation board and wait for its answer.

    Several are sent in the order interval, focus, shutter. A command that is repeated because its
    answer was lost is not done twice.
    """

    id, name, group = "sync_board_send", "Command the sync board", "ingest"
    command = ("sync-board", "send")
    needs_project = False

    def run(self, context: Context, parameters: SendParameters, feedback: Feedback) -> Result:
        """Send."""
        from georef_gis.ingest.serial_port import open_port
        from georef_gis.ingest.sync_board import Command, CommandName, new_number, send_command

        wishes: list[tuple[CommandName, float | None]] = []
        if parameters.interval is not None:
            wishes.append(("INTERVAL", parameters.interval))
        wishes += [("FOCUS", None)] if parameters.focus else []
        wishes += [("SHUTTER", None)] if parameters.shutter else []
        if not wishes:
            raise InputError("nothing to send; give --interval S, --focus or --shutter")
        summary = {}
        port = open_port(parameters.port, parameters.baud)
        number = new_number()
        try:
            for step, (name, value) in enumerate(wishes):
                command = Command(name=name, number=(number + step) % 10_000, value=value)
                answer = send_command(
                    port, command, timeout=parameters.timeout, attempts=parameters.attempts
                )
                again = f" at attempt {answer.attempts}" if answer.attempts > 1 else ""
                summary[name.lower()] = f"acknowledged{again}"
        finally:
            port.close()
        return Result(summary=summary)


class SimulateBoardParameters(p.Parameters):
    """Parameters of `sync_board_simulate`."""

    interval: p.Number = p.number(1.5, title="Interval between triggers", unit="s", ge=0, le=3600)
    duration: p.Number | None = p.number(
        None, title="Time after which to end", unit="s", gt=0, help="Else until Ctrl-C"
    )
    jitter: p.Number = p.number(0.0, title="Sigma of the trigger times", unit="s", ge=0, le=1)
    missed: p.Number = p.number(0.0, title="Share of lines not sent", ge=0, le=1)
    spurious: p.Number = p.number(0.0, title="Share of extra triggers", ge=0, le=1)
    flipped: p.Number = p.number(0.0, title="Share of bytes with a flipped bit", ge=0, le=1)
    lost: p.Number = p.number(0.0, title="Share of bytes lost", ge=0, le=1)
    speed: p.Number = p.number(1.0, title="Times as fast as in truth", gt=0, le=1000, advanced=True)
    link: p.File | None = p.file(None, title="Name to give the device as well", writes=True)


class SimulateBoard(Algorithm[SimulateBoardParameters]):
    """Play a time-synchronisation board on a pseudo-terminal, for trials without hardware.

    Says the name of its device, which `georef sync-board record` and `send` take as PORT. Not on
    Windows, which has no pseudo-terminals.
    """

    id, name, group = "sync_board_simulate", "Simulate the sync board", "ingest"
    command = ("sync-board", "simulate")
    needs_project = False

    def run(
        self, context: Context, parameters: SimulateBoardParameters, feedback: Feedback
    ) -> Result:
        """Play it."""
        import threading

        from georef_gis.simulate.sync_board import (
            BoardSettings,
            PseudoTerminal,
            SimulatedBoard,
            gps_now,
            serve,
        )

        names = ("interval", "jitter", "missed", "spurious", "flipped", "lost")
        values = {name: getattr(parameters, name) for name in names}
        board = SimulatedBoard(BoardSettings(**values, start_gps=gps_now()), context.seed)
        terminal = PseudoTerminal(parameters.link)
        stop = threading.Event()
        thread = threading.Thread(
            target=serve, args=(board, terminal, stop), kwargs={"speed": parameters.speed}
        )
        feedback.info(f"the board is at {parameters.link or terminal.device}; Ctrl-C ends")
        thread.start()
        started = time.monotonic()
        try:
            while not feedback.cancelled() and thread.is_alive():
                elapsed = time.monotonic() - started
                if parameters.duration is not None and elapsed >= parameters.duration:
                    break
                fraction = elapsed / parameters.duration if parameters.duration else 0.0
                feedback.progress(fraction, f"{len(board.triggers)} triggers")
                time.sleep(_LOOK_EVERY)
        except KeyboardInterrupt:
            pass
        finally:
            stop.set()
            thread.join()
            terminal.unplug()
        sent = sum(trigger.sent for trigger in board.triggers)
        return Result(summary={"triggers": len(board.triggers), "lines_sent": sent})


class DecodeParameters(p.Parameters):
    """Parameters of `sync_board_decode`."""

    log: p.File = p.file(title="Log of the recorder: a text table with a header", positional=True)
    channel: p.Text = p.text(title="Column of the servo channel")
    time_column: p.Text = p.text("", title="Column of the time", help="Else found by its name")
    output: p.File = p.file(
        Path("sync_board_index.csv"), title="Table of photos", suffixes=(".csv",), writes=True
    )
    step: p.Number | None = p.number(
        None, title="Step of the index, in the unit of the channel", help="Else learnt"
    )
    levels: p.Integer | None = p.integer(
        None, title="Levels before the wrap", help="Else learnt", ge=2, le=2000
    )


class Decode(Algorithm[DecodeParameters]):
    """Find the photos in the PWM index that a recorder logged on a servo channel.

    The index rises by one step at every photo and wraps. Step and levels are learnt from the
    channel. Every photo gets a time, its sigma, its number and a confidence.
    """

    id, name, group = "sync_board_decode", "Photos of a PWM index", "ingest"
    command = ("sync-board", "decode")
    needs_project = False
    outputs = (Output(name="index", title="Photos"),)

    def run(self, context: Context, parameters: DecodeParameters, feedback: Feedback) -> Result:
        """Decode."""
        import numpy as np

        from georef_gis.ingest.pwm_index import decode_pwm_index
        from georef_gis.ingest.recorder_channel import read_channel, write_index

        channel = read_channel(parameters.log, parameters.channel, parameters.time_column)
        index = decode_pwm_index(
            channel.time, channel.value, step=parameters.step, levels=parameters.levels,
            source=f"{parameters.log}: {parameters.channel}",
        )  # fmt: skip
        write_index(parameters.output, index, channel)
        return Result(
            outputs={"index": parameters.output},
            summary={
                "products": [str(parameters.output)],
                "photos": len(index),
                **_scale(index),
                "sigma_s": float(np.median(index.sigma)) if len(index) else None,
                "doubts": [*channel.doubts, *index.doubts],
            },
        )


def _scale(index: PwmIndex) -> dict[str, object]:
    return {
        "step": index.scale.step,
        "levels": index.scale.levels if index.scale.wrap_known else None,
        "noise": index.scale.noise,
    }


SYNC_BOARD_TOOLS = (Record, ListPorts, Send, SimulateBoard, Decode)
