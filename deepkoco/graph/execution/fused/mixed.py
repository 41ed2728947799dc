"""Bodies that work on several blocks side by side.

A statement of a Runge-Kutta step waits for the one before it, four cycles or more, and a processor looks only some hundred
instructions ahead. So each statement is written for all blocks before the next one. Such a body has no branches: angles that
are too large for the fast sine are noted, and then everything is done again one by one.
"""

import re

from deepkoco.graph.execution.fused.body import Body

MOST_STATEMENTS = 600
"""Of a body that is written for several blocks: longer ones take the compiler too long."""

_OWN = re.compile(r"\b(v\d+|far|P|H|S|X|Q|T|S2|Y)\b")
"""Names of which each block has its own."""

_POINTERS = (
    *(("const char *", name) for name in ("P", "H", "S")),
    ("const char *const *", "X"),
    ("const VL *", "Q"),
    ("const VD *", "T"),
    *(("char *", name) for name in ("S2", "Y")),
)
_ARGUMENTS = ("P", "H", "S", "X", "Q", "T", "nullptr", "S2", "Y")


def mixes(body: Body) -> bool:
    """Whether a body has only statements that can be mixed: definitions of lane vectors, and what it stores at its end."""
    stores = [line.startswith("st(") for line in body.lines]
    plain = all(store or line.startswith("const V") for line, store in zip(body.lines, stores, strict=True))
    return plain and stores == sorted(stores) and len(stores) <= MOST_STATEMENTS


def mixed_body(body: Body, index: int, blocks: int) -> list[str]:
    """The function of a node for a number of blocks, from a body that is finished.

    Args:
        body: which `mixes`.
        index: of the node.
        blocks: how many at once; of one there is no such function.
    """
    if blocks == 1:
        return []
    copies = range(blocks)
    lines = [f"static void mixed_{index}(const Call &c, const char *K) {{ // {body.name}"]
    lines += [f"  {kind}const {name}_{k} = c.{name}[{k}];" for kind, name in _POINTERS for k in copies]
    lines += [f"  FarLater far_{k};" for k in copies]
    computed = [line for line in body.lines if not line.startswith("st(")]
    stored = [line for line in body.lines if line.startswith("st(")]
    lines += [_of_block(line, k) for line in [*body.loads(), *computed] for k in copies]
    found = " | ".join(f"far_{k}.found()" for k in copies)
    lines += [f"  if (__builtin_expect({found}, 0)) {{"]
    for k in copies:
        own = ", ".join(name if name == "nullptr" else f"{name}_{k}" for name in _ARGUMENTS)
        lines.append(f"    body_{index}({own}, K);")
    lines += ["    return;", "  }"]
    return lines + [_of_block(line, k) for line in stored for k in copies] + ["}", ""]


def _of_block(line: str, k: int) -> str:
    return "  " + _OWN.sub(rf"\1_{k}", line)
