"""The `mavdiag` command (edge): reads arguments, calls the library, prints."""

from typing import NoReturn

from mavdiag import commandline
from mavdiag.commands import export, history, identify, inspect, model, report, scan, setup, shim, tools, watch
from mavdiag.demo import command as demo

app = commandline.application("Find a damaged propeller: learn a healthy airframe, judge its flights by it.")
for step in (setup.setup, identify.identify, scan.scan, report.report, export.export):
    app.command()(step)
app.command("look")(inspect.inspect)
for command in (demo.demo, tools.balance, inspect.inspect, watch.watch, watch.replay, tools.ack, tools.warm, shim.shim):
    app.command()(command)
app.add_typer(identify.app, name="baseline")
app.add_typer(model.app, name="model")
app.add_typer(history.app, name="history")


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "mavdiag")
