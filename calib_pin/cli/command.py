"""How the commands present themselves in `--help`."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand


class Command(TyperCommand):
    """A command whose help reads `ROBOT MEASUREMENTS...`, with options by topic."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words of the usage line."""
        arguments = [p for p in self.get_params(ctx) if p.param_type_name != "option"]
        return ["[OPTIONS]", *(argument.metavar or "" for argument in arguments)]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Let an option whose value stands in brackets do without one."""
        alone = {
            name
            for param in self.get_params(ctx)
            if param.param_type_name == "option" and str(param.metavar)[:1] == "["
            for name in param.opts
        }
        words = []
        for word, following in zip(args, [*args[1:], "-"], strict=False):
            words.append(word)
            if word in alone and following.startswith("-"):
                words.append("")
        return super().parse_args(ctx, words)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments, then the options under the heading of their help panel."""
        topics: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            if param.param_type_name != "option":
                row = (param.metavar or "", getattr(param, "help", None) or "")
                topics.setdefault("Arguments", []).append(row)
            elif record := param.get_help_record(ctx):
                topic = getattr(param, "rich_help_panel", None) or "Other"
                topics.setdefault(topic, []).append((record[0], _filled(record[1])))
        for topic, rows in topics.items():
            with formatter.section(topic):
                formatter.write_dl(rows)


def _filled(text: str) -> str:
    """A help text with the names of all members of a family in its braces."""
    if "{parameterizations}" in text:
        # Its import takes long, and only this help asks.
        from calib_pin.parameterizations import PARAMETERIZATIONS, beyond_geometry
        from calib_pin.setup import Setup

        beyond = beyond_geometry()
        geometric = [
            f"{name} (default)" if name in Setup.parameters else name
            for name in PARAMETERIZATIONS
            if name not in beyond
        ]
        names = f"{', '.join(geometric)}; beyond geometry {', '.join(beyond)}"
        text = text.replace("{parameterizations}", names)
    return text
