"""The `mavdiag` command (edge): reads arguments, calls the library, prints."""

from typing import NoReturn

from mavdiag import commandline
from mavdiag.commands import (
    export,
    history,
    identify,
    inspect,
    model,
    report,
    scan,
    setup,
    shim,
    tools,
    watch,
)
from mavdiag.demo import command as demo

app = commandline.application("Find a damaged propeller: learn a healthy airframe, judge its flights by it.", "mavdiag")
app.command("setup")(setup.setup)
app.command("identify")(identify.identify)
app.command("scan")(scan.scan)
app.command("report")(report.report)
app.command("export")(export.export)
app.command("look")(inspect.inspect)
app.command("demo")(demo.demo)
app.command("balance")(tools.balance)
app.command("inspect")(inspect.inspect)
app.command("watch")(watch.watch)
app.command("replay")(watch.replay)
app.command("ack")(tools.ack)
app.command("warm")(tools.warm)
app.command("shim")(shim.shim)
app.add_typer(identify.app, name="baseline")
app.add_typer(model.app, name="model")
app.add_typer(history.app, name="history")


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "mavdiag")
