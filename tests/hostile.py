"""Names and units that a stranger may have written into a file, to be inert wherever they are shown."""

import unicodedata
from itertools import product

ESC, BEL, ST = "\x1b", "\x07", "\x9c"
# What ends, opens or continues something in the language of a sink, by language.
C = (
    "*/", "*\\", "/*", "*\\\n/", "*\\\r\n/", "*??/\n/", "*/ int x; /*", "//", "\\", "\\\n", "??/", "??/\n",
    "%:error", "\n#error x", '"', "'",
    "*/ __attribute__((constructor)) void f(void) { system(\"touch x\"); } /*", "/**/", "*",
    "#include \"/etc/passwd\"", "\x0c*/", "*\u2215", "*\x0b/", "* /", "*\x00/", "*\u200b/", "\uff0a/",
    "*\u2028/",
)  # fmt: skip
PYTHON = (
    '"""', "'''", '"""\nimport os\n"""', '\\"""', '""\\"', "\\N{", "\\x", "\\u12", "\n    x = 1", "{}",
    "{0}", "{x!r}", "%s", "%(x)s", "\r", "\x0c", "\ufeff", "# coding: utf-7", "\u2028import os",
    "__import__('os')",
)  # fmt: skip
TEMPLATES = (
    "{{ 7 * 7 }}", "{% raw %}", "{% for x in y %}", "{# #}", "{{ ''.__class__ }}", "#eval(\"1\")",
    "#read(\"/etc/passwd\")", "#set page(", "#[x]", "#let x = 1", "= heading", "@label", "<label>", "```",
    "$ x", "\\#", "#include \"x\"", "*bold", "[content]", "]", "#", "//comment", "#raw(", "_x_",
)  # fmt: skip
HTML = (
    "<script>alert(1)</script>", "</script>", "</title><b>", "<!--", "-->", "]]>", "<![CDATA[", "&amp;",
    "&#0;", "&lt;", "' onload='x", '" onload="x', "<svg onload=x>", "<img src=x onerror=y>", "javascript:x",
    "<", ">", "&", "</style>", "<?xml?>", "<!DOCTYPE x [<!ENTITY y SYSTEM '/etc/passwd'>]>", "&y;",
    "</svg>", "<a href='x'>", "\u2028<b>", "</td>", "<base href=x>", "url(#a)", ' id="x"', "#1b1b1f",
    "<foreignObject/>",
)  # fmt: skip
MATHEMATICS = (
    "$", "$$", "$x$", "$\\frac$", "$\\undefined$", "\\$", "$a$ $b", "\\input{/etc/passwd}", "$\\mathrm{",
    "^_{}", "%",
)  # fmt: skip
MARKDOWN = (
    "|", "| a | b", "[x](http://x)", "![x](http://x)", "[x]: http://x", "`x`", "~~~", "# x", "- x", "> x",
    "1. x", "---", "***", "<http://x>", "\\|", "\n\n# x", "\n| x |", "\t x",
)  # fmt: skip
BEGINNINGS = ("=", "+", "-", "@", "\t=", "\r=", "\n=", " =", "\uff1d", "\uff0b", "\uff0d", "\uff20")
FORMULAS = (
    *map("".join, product(BEGINNINGS, ("1+1", "cmd|' /C calc'!A0"))),
    '=HYPERLINK("http://x","y")', "{=1+1}", "=IMPORTXML(A1)", "http://x", "mailto:x", "internal:x",
    "-5 mm", "+A1", "'=1",
)  # fmt: skip
TERMINAL = (
    f"{ESC}[2J", f"{ESC}[31mred", f"{ESC}]0;title{BEL}", f"{ESC}]8;;http://x{ESC}\\x{ESC}]8;;{ESC}\\",
    f"{ESC}c", ESC, f"{ESC}]52;c;eA=={BEL}", f"{ESC}[6n", f"{ESC}P+q{ESC}\\", "\x9b2J", f"\x9d0;x{ST}",
    "\x90x", "\x08\x08", "\r\x1b[K", "\x7f", "\x00", "a\x00b", BEL, "\x0e", "\x85", "[bold]x[/bold]",
    "[/x]", "[link=http://x]x", ":smile:", "\x1a", "\x04", "\x03",
)  # fmt: skip
UNICODE = (
    "\u202e", "\u202elairt\u202c", "\u2066x\u2069", "\u200f", "\u061c", "\u2067", "\u200b", "\u2060",
    "\ufeffx", "\u00ad", "\ud800", "\udcff", "a\udcffb", "\ufffe", "\uffff", "\U0001ffff", "\U000e0041",
    "\ufdd0", "\u2028", "\u2029", "\u0085", "e\u0301"* 30, "\u0300"* 50, "\ue000", "\U000f0000", "שלום",
    "مرحبا", "測定", "😀", "\u180e", "\u3164", "\uff1c", "°C µ Ω",
)  # fmt: skip
LONG = (
    "a"* 3000, "*/"* 1000, "$"* 501, "="* 300, " "* 300+ "x", "\n"* 100, "", " ", "/"* 200, "é"* 500,
)  # fmt: skip
STRINGS = tuple(
    dict.fromkeys(
        (*C, *PYTHON, *TEMPLATES, *HTML, *MATHEMATICS, *MARKDOWN, *FORMULAS, *TERMINAL, *UNICODE, *LONG)
    )
)
HARMLESS_FORMATS = "\u200c\u200d"  # joiners within words


def acts(character: str) -> bool:
    """Return whether a character acts on a terminal, or on how the text around it is shown."""
    return (
        unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp")
        and character not in HARMLESS_FORMATS
    )
