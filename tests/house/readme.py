"""What the README shows, and whether something else printed it."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")


def same(printed: list[str], shown: list[str]) -> None:
    """The same words in the same lines, and numbers that are the same but for the rounding of another machine: by two
    hundredths, or one in the last digit shown."""
    bare, expected = ([" ".join(NUMBER.sub("#", line).split()) for line in text] for text in (printed, shown))
    assert bare == expected
    for line, other in zip(printed, shown, strict=True):
        for x, y in zip(NUMBER.findall(line), NUMBER.findall(other), strict=True):
            digits, _, exponent = y.partition("e")
            last = 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
            assert abs(float(x) - float(y)) <= max(0.02 * abs(float(y)), 1.01 * last), f"{line!r}, not {other!r}"
