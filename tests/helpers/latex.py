"""Checks of LaTeX without an engine."""

from __future__ import annotations

import re


def assert_tabular(text: str) -> None:
    """Check what TeX would reject: environments, braces, cells per row, unknown commands."""
    begun = re.findall(r"\\begin\{(\w+)\}", text)
    assert begun == re.findall(r"\\end\{(\w+)\}", text) == ["tabular"]
    bare = re.sub(r"\\[{}]", "", text)
    assert bare.count("{") == bare.count("}")
    width = len(re.sub(r"[^lcr]", "", re.search(r"\\begin\{tabular\}\{(.*)\}", text)[1]))
    known = {"begin", "end", "toprule", "midrule", "bottomrule", "cmidrule", "multicolumn", "textbf", "uparrow"}
    known |= {"downarrow", "circ", "footnotesize", "textbackslash", "textasciitilde", "textit", "quad", "parbox"}
    known |= {"smallskip", "noindent", "linewidth", "raggedright", "setlength", "tabcolsep"}
    known |= {"textless", "textgreater", "textbar", "textasciicircum"}
    assert set(re.findall(r"\\([a-zA-Z]+)", text)) <= known
    lines = [line for line in text.split("\\end{tabular}")[0].splitlines() if line.endswith("\\\\")]
    assert lines
    for line in lines:
        spans = sum(int(n) - 1 for n in re.findall(r"\\multicolumn\{(\d+)\}", line))
        assert len(re.findall(r"(?<!\\)&", line)) + 1 + spans == width, line
    assert not re.search(r"(?<!\\)[%#_]", text.replace("\\_", ""))
