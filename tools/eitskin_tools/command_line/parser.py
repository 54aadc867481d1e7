"""A parser that reports an error in one line, suggests what was probably meant, and keeps its help short.

Its subparsers are of the same class, so that ``eitskin bench skp`` and ``eitskin run --solvr`` are answered alike.
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from eitskin_proto.fields import did_you_mean
from eitskin_proto.files.plain import plain


def expected_one_of(what: str, word: str, names: Iterable[str]) -> str:
    """Return ``--solver is 'vd2'; expected one of vd2t, tikhonov; did you mean 'vd2t'?``."""
    listed = list(names)
    return f"{what} is {word!r}, expected one of {', '.join(listed)}{did_you_mean(word, listed)}"


@dataclass(frozen=True)
class Bounded:
    """An argument's type: a number within bounds, or several.

    Args:
        kind: Makes it of a text.
        expected: What the parser says where a text is no such number.
        holds: Whether a number is within the bounds.
    """

    kind: Callable[[str], Any]
    expected: str
    holds: Callable[[Any], bool]

    def __call__(self, text: str) -> Any:
        """Return the number.

        Raises:
            ValueError: It is none, or not within the bounds.
        """
        if not self.holds(value := self.kind(text)):
            raise ValueError(self.expected)
        return value


def whole(least: int, most: int | None = None) -> Bounded:
    """Return the type of whole numbers from a bound on, or within two."""
    if most is None:
        return Bounded(int, f"at least {least}", lambda value: value >= least)
    return Bounded(int, f"{least} to {most}", lambda value: least <= value <= most)


def positive(most: float = float("inf")) -> Bounded:
    """Return the type of numbers above 0, up to a bound."""
    bound = "" if most == float("inf") else f" and at most {most:.0f}"
    return Bounded(float, f"more than 0{bound}", lambda value: 0.0 < value <= most)


def within(low: float, high: float) -> Bounded:
    """Return the type of numbers within two bounds."""
    return Bounded(float, f"{low:g} to {high:g}", lambda value: low <= value <= high)


CPUS: Final = Bounded(
    lambda text: tuple(int(part) for part in text.split(",")),
    "CPU numbers such as 2 or 2,3",
    lambda cpus: min(cpus) >= 0,
)
"""``--affinity``."""


class Parser(argparse.ArgumentParser):
    """An ``argparse.ArgumentParser`` with errors of one line, exit status 2, suggestions, and help in two lengths."""

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self._more: list[Any] = []

    def add_more(self, title: str) -> Any:
        """Return a group of options that ``--help-all`` lists and ``--help`` only mentions by its title."""
        if not self._more:
            self.add_argument("--help-all", action=_HelpAll, nargs=0, help="show all options and exit")
        self._more.append(self.add_argument_group(title))
        return self._more[-1]

    def format_help(self) -> str:
        """Return the everyday options, and where the others are listed."""
        if not self._more:
            return self.format_all()
        hidden = {id(action) for group in self._more for action in group._group_actions}
        groups, actions = self._action_groups, self._actions
        self._action_groups = [group for group in groups if group not in self._more]
        self._actions = [action for action in actions if id(action) not in hidden]
        try:
            titles = ", ".join(str(group.title) for group in self._more)
            return f"{self.format_all()}\n{len(hidden)} more options ({titles}): {self.prog} --help-all\n"
        finally:
            self._action_groups, self._actions = groups, actions

    def format_all(self) -> str:
        """Return all options."""
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with status 2."""
        more = f"; '{self.prog} --help' shows its options" if "arguments are required" in message else ""
        self.exit(2, f"{self.prog}: {plain(message)}{more}\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and refuse what is left over here, where the options that there are are known."""
        found, left = super().parse_known_args(args, namespace)
        if left:
            self.error(self._left_over(left[0]))
        return found, left

    def _left_over(self, word: str) -> str:
        if not word.startswith("-"):
            return f"found {word!r}, expected nothing more; '{self.prog} --help' shows its options"
        options = [option for action in self._actions for option in action.option_strings]
        name = word.partition("=")[0]
        return f"no option {name!r}{did_you_mean(name, options) or self._listed()}"

    def _listed(self) -> str:
        return f"; '{self.prog} --help' lists them"

    def _get_value(self, action: argparse.Action, text: str) -> Any:
        try:
            return super()._get_value(action, text)
        except argparse.ArgumentError:
            if not isinstance(action.type, Bounded):
                raise
            self.error(f"{'/'.join(action.option_strings)} is {text}, expected {action.type.expected}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        names = [str(choice) for choice in _choices(action)]
        if isinstance(action.choices, dict):  # subcommands
            self.error(f"no {action.dest} {value!r}{did_you_mean(str(value), names) or self._listed()}")
        name = "/".join(action.option_strings) or str(action.metavar or action.dest)
        self.error(expected_one_of(name, str(value), names))


class _HelpAll(argparse.Action):
    """``--help-all``: print every option and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print(parser.format_all() if isinstance(parser, Parser) else parser.format_help(), end="")
        parser.exit()


def _choices(action: argparse.Action) -> Iterable[Any]:
    return action.choices or ()
