"""Bodies that work on several blocks side by side.

A statement of a Runge-Kutta step waits for the one before it, four cycles or more, and a processor looks only some
hundred instructions ahead. So each statement is written for all blocks before the next one. Such a body has no
branches: angles that are too large for the fast sine are noted, and then everything is done again one by one.
"""

import re

from deepkoco.graph.execution.fused.body import Body

SIDE_BY_SIDE = 4
"""Blocks whose statements are mixed, so that the processor need not wait for the result of one before the next."""

MOST_STATEMENTS = 600
"""Of a body that is written for several blocks: longer ones take the compiler too long."""

_OWN = re.compile(r"\b(v\d+|far|P|H|S|X|Q|T|A|S2|Y|R|G)\b")
"""Names of which each block has its own."""

_POINTERS = (
    *(("const char *", name) for name in ("P", "H", "S")),
    ("const char *const *", "X"),
    ("const VL *", "Q"),
    ("const VD *", "T"),
    ("const char *", "A"),
    *(("char *", name) for name in ("S2", "Y")),
)
_ARGUMENTS = "P", "H", "S", "X", "Q", "T", "A", "S2", "Y"

_PRODUCT = re.compile(r"matvec<(.+)>\((\w+), (.+), (\w+), (\w+)\);")
"""What a product of a vector and shared numbers looks like: sizes, vector, numbers, what is added, result."""

_LOOPS = re.compile(r"(?:LOOP )?(?:for \([^)]*\) )+")
_ARRAY = re.compile(r"(V\w+ a\d+\[\d+\]);")
_ELEMENT = re.compile(r"\b(a\d+)\[([^\[\]]*)\]")
_WHOLE = re.compile(r"\ba\d+\b(?!\[)")
"""Loops before a statement, a new array, an element of one, and an array in any other place."""


def mixes(body: Body) -> bool:
    """Whether a body has only statements that can be mixed: definitions of lane vectors, and stores at its end.

    Large constants stand in the pool of a node, which a mixed body does not open.
    """
    stores = [line.startswith("st(") for line in body.lines]
    plain = all(store or line.startswith("const V") for line, store in zip(body.lines, stores, strict=True))
    return plain and not body.shared and stores == sorted(stores) and len(stores) <= MOST_STATEMENTS


def mixed_body(body: Body, head: str, exact: str, blocks: int) -> list[str]:
    """The function of a node for one or several blocks, from a body that is finished.

    Args:
        body: which `mixes`.
        head: name and arguments of the function.
        exact: name of the function that does it all again for one block if an angle is too large.
        blocks: how many at once; the arguments of more than one stand in a `Call`.
    """
    copies = range(blocks) if blocks > 1 else [None]
    lines = [f"static void {head} {{ // {body.name}"]
    if blocks > 1:
        lines += [f"  {kind}const {name}_{k} = c.{name}[{k}];" for kind, name in _POINTERS for k in copies]
    computed = [line for line in body.lines if not line.startswith("st(")]
    stored = [line for line in body.lines if line.startswith("st(")]
    lines += [_of_block(line, k) for line in ["FarLater far;", *body.loads(), *computed] for k in copies]
    found = " | ".join(_of_block("far.found()", k).strip() for k in copies)
    again = [_of_block(f"  {_if_asked(k)}{exact}({', '.join(_ARGUMENTS)}, K);", k) for k in copies]
    lines += [f"  if (__builtin_expect({found}, 0)) {{", *again, "    return;", "  }"]
    return lines + [_of_block(line, k) for line in stored for k in copies] + ["}", ""]


def mixed_policy(lines: list[str], blocks: int) -> list[str] | None:
    """Statements of a policy for a number of blocks: products with its weights are taken for all at once.

    The blocks lie side by side in the arrays too, element by element.

    Args:
        lines: those for one block; weights are named k1, k2, ...
        blocks: how many at once.

    Returns:
        None if an array is used in another way than by elements or in such a product.
    """
    mixed = []
    for line in lines:
        product, array = _PRODUCT.fullmatch(line), _ARRAY.fullmatch(line)
        if product is not None:
            sizes, vector, numbers, added, result = product.groups()
            mixed.append(f"  matvecs<{sizes}, {blocks}>({vector}, {numbers}, {added}, {result});")
        elif array is not None:
            mixed.append(f"  {array[1]}[{blocks}];")
        elif _WHOLE.search(line):
            return None
        else:
            head = _LOOPS.match(line)
            loop, statement = (head[0], line[head.end() :]) if head else ("", line)
            each = [_ELEMENT.sub(rf"\1[\2][{k}]", _of_block(statement, k)) for k in range(blocks)]
            mixed += [f"  {loop}{{", *each, "  }"] if loop else each
    return mixed


def _if_asked(k: int | None) -> str:
    # Not again for a block that only fills up: its state would move twice.
    return f"if (c.count > {k}) " if k else ""


def _of_block(line: str, k: int | None) -> str:
    return "  " + (line if k is None else _OWN.sub(rf"\1_{k}", line))
