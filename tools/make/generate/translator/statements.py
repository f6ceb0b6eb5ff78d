"""Statements of a step in C: assignments, conditions, loops that count."""

import ast
import re
from collections.abc import Sequence

from pcpc.tools.make.generate.translator.calls import Calls
from pcpc.tools.make.generate.translator.expressions import as_kind
from pcpc.tools.make.generate.translator.kinds import (
    TRUTH,
    WHOLE,
    Callee,
    CellsKind,
    Kind,
    Number,
    Several,
    Value,
    View,
    c_name,
    common_kind,
)
from pcpc.tools.make.generate.translator.places import Places
from pcpc.tools.make.generate.translator.source import names

_SIGNS = {ast.Add: "+=", ast.Sub: "-=", ast.Mult: "*=", ast.Div: "/="}
_PLAIN_END = re.compile(r"-?[0-9]+|[A-Za-z_]\w*")


class Statements(Calls):
    """Translates statements; `Function` puts them together."""

    places: Places
    body: Sequence[ast.stmt]
    results: tuple[Kind, ...]
    result_names: list[str]

    def declared(self, name: str, kind: Kind, changed: bool) -> str:
        """Return the declaration of an argument or an alias."""
        raise NotImplementedError

    def block(self, body: Sequence[ast.stmt], after: int) -> list[str]:
        """Return the lines of statements; comments behind line `after` belong to them."""
        raise NotImplementedError

    def statement(self, stmt: ast.stmt) -> None:
        """Add the lines of a statement. Raises Untranslatable."""
        made = getattr(self, f"_do_{type(stmt).__name__.lower()}", None)
        if made is None:
            said = ast.unparse(stmt).splitlines()[0]
            raise self.error(stmt, f"`{said}` has no meaning in C; write assignments and loops")
        made(stmt)

    def _do_pass(self, stmt: ast.Pass) -> None:
        pass

    def _do_break(self, stmt: ast.Break) -> None:
        self.lines.append("break;")

    def _do_continue(self, stmt: ast.Continue) -> None:
        self.lines.append("continue;")

    def _do_expr(self, stmt: ast.Expr) -> None:
        if isinstance(stmt.value, ast.Constant):
            return
        call = self.value(stmt.value)
        if isinstance(call.kind, Several):
            self._call_for(call, stmt)
        elif call.kind is None:
            self.lines.append(f"{call.text};")
        elif not call.fixed:
            raise self.error(stmt, f"`{ast.unparse(stmt)}` changes nothing")

    def _do_annassign(self, stmt: ast.AnnAssign) -> None:
        if stmt.value is None:
            raise self.error(stmt, "give it a value")
        self._assign(stmt, [stmt.target], stmt.value)

    def _do_assign(self, stmt: ast.Assign) -> None:
        self._assign(stmt, stmt.targets, stmt.value)

    def _assign(self, stmt: ast.stmt, targets: Sequence[ast.expr], value: ast.expr) -> None:
        if len(targets) == 1 and isinstance(targets[0], ast.Tuple):
            self._assign_several(stmt, targets[0].elts, value)
            return
        found = self._direct(value)
        if len(targets) > 1:
            found = self.kept(found)
        for target in targets:
            self._store(stmt, target, found)

    def _direct(self, node: ast.expr) -> Value:
        """Return a value; a call that ends with it needs no constant of its own."""
        value = self.value(node)
        line = self.lines[-1] if self.lines else ""
        begin = f" {value.text} = "
        if isinstance(node, ast.Call) and line.startswith("const ") and begin in line:
            self.lines.pop()
            return Value(line.partition(" = ")[2].removesuffix(";"), value.kind)
        return value

    def _assign_several(self, stmt: ast.stmt, targets: Sequence[ast.expr], value: ast.expr) -> None:
        if isinstance(value, ast.Tuple):
            if len(value.elts) != len(targets):
                raise self.error(stmt, f"{len(value.elts)} values for {len(targets)} names")
            if len(value.elts) > 1 and self._tangled(targets, value.elts):
                values = [self.kept(one, copy=True) for one in self.operands(value.elts)]
            else:
                values = []
                for target, one in zip(targets, value.elts, strict=True):
                    self._store(stmt, target, self._direct(one))
                return
        else:
            call = self.value(value)
            if not isinstance(call.kind, Several) or len(call.kind.kinds) != len(targets):
                raise self.error(stmt, f"{ast.unparse(value)} does not give {len(targets)} values")
            if self._into(stmt, targets, call):
                return
            values = self._call_for(call, stmt)
        for target, found in zip(targets, values, strict=True):
            self._store(stmt, target, found)

    def _into(self, stmt: ast.stmt, targets: Sequence[ast.expr], call: Value) -> bool:
        """Let a call write to the targets, where all are local variables of its kinds."""
        assert isinstance(call.kind, Several)
        if not all(isinstance(target, ast.Name) for target in targets):
            return False
        ids = [target.id for target in targets if isinstance(target, ast.Name)]
        if len(set(ids)) != len(ids) or "_" in ids:
            return False
        for name, kind in zip(ids, call.kind.kinds, strict=True):
            self._join(stmt, name, kind)
        if any(self.kinds[n] != kind for n, kind in zip(ids, call.kind.kinds, strict=True)):
            return False
        for name, kind in zip(ids, call.kind.kinds, strict=True):
            if name in self.places.by[id(stmt)]:
                self.lines.append(f"{kind.name} {c_name(name)};")
        given = call.text if call.text.endswith("(") else f"{call.text}, "
        self.lines.append(given + ", ".join(f"&{c_name(name)}" for name in ids) + ");")
        return True

    @staticmethod
    def _tangled(targets: Sequence[ast.expr], values: Sequence[ast.expr]) -> bool:
        """Return whether a value may depend on a target that comes before it."""
        return any(
            _changes(target, later) for i, target in enumerate(targets) for later in values[i + 1 :]
        )

    def _join(self, stmt: ast.AST, name: str, kind: Kind) -> None:
        both = common_kind(self.kinds.get(name), kind)
        if both is None and self.kinds.get(name) is not None:
            raise self.error(stmt, f"{name} is of another kind before; take another name")
        if name in self.counted:
            raise self.error(stmt, f"{name} counts a loop; take another name")
        self.kinds[name] = both

    def _store(self, stmt: ast.stmt, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Name) and target.id == "_":
            return
        if isinstance(target, ast.Name):
            self._store_local(stmt, target.id, value)
            return
        if not isinstance(value.kind, Number):
            raise self.error(stmt, f"{ast.unparse(target)}: set several values one by one")
        where = self.value(target)
        if not isinstance(where.kind, Number):
            raise self.error(stmt, f"{ast.unparse(target)} has several values: set them one by one")
        self.wrote(where.root)
        text = f"(double){value.at(14)}" if value.kind == TRUTH else value.text
        text = as_kind(value, where.kind).text if value.kind == WHOLE else text
        self.lines.append(f"{where.text} = {text};")

    def _store_local(self, stmt: ast.stmt, name: str, value: Value) -> None:
        if value.kind is None or isinstance(value.kind, Several):
            raise self.error(stmt, f"{name} would be nothing, or several values")
        self._join(stmt, name, value.kind)
        fresh = name in self.places.by[id(stmt)]
        if isinstance(value.kind, Number):
            kind = self.kinds[name]
            assert isinstance(kind, Number)
            const = "const " if fresh and self._stored_once(name) else ""
            begin = f"{const}{kind.name} {c_name(name)}" if fresh else c_name(name)
            self.lines.append(f"{begin} = {as_kind(value, kind).text};")
            return
        if not fresh or not self._stored_once(name) or isinstance(value.kind, Callee):
            raise self.error(stmt, f"{name} stands for ports: name them once, before any `if`")
        self.roots[name] = value.root
        if name in self.written:
            self.wrote(value.root)
        begin = self.declared(c_name(name), value.kind, name in self.written)
        text = value.address() if isinstance(value.kind, View) else value.text
        if isinstance(value.kind, CellsKind) and text.startswith("(") and name in self.written:
            text = text.replace("(const double *)", "(double *)", 1)
        if (
            isinstance(value.kind, CellsKind)
            and len(value.kind.shape) > 1
            and name not in self.written
        ):
            rest = "".join(f"[{extent}]" for extent in value.kind.shape[1:])
            text = f"(const {value.kind.element.name} (*){rest}){text}"
        self.lines.append(f"{begin} = {text};")

    def _stored_once(self, name: str) -> bool:
        stores = [
            one
            for stmt in self.body
            for one in ast.walk(stmt)
            if isinstance(one, ast.Name) and one.id == name and isinstance(one.ctx, ast.Store)
        ]
        return len(stores) == 1

    def _do_augassign(self, stmt: ast.AugAssign) -> None:
        if type(stmt.op) not in _SIGNS:
            raise self.error(stmt, f"`{ast.unparse(stmt)}`: write it with +, -, * or /")
        before = len(self.lines)
        local = isinstance(stmt.target, ast.Name)
        value = self._direct(stmt.value) if local else self.value(stmt.value)
        if isinstance(stmt.target, ast.Name):
            self._join(
                stmt, stmt.target.id, common_kind(self.kinds.get(stmt.target.id), value.kind)
            )
            text, kind = c_name(stmt.target.id), self.kinds[stmt.target.id]
        else:
            if len(self.lines) > before:
                raise self.error(stmt, "a call that changes states; give it a line of its own")
            where = self.value(stmt.target)
            self.wrote(where.root)
            text, kind = where.text, where.kind
        self.lines.append(f"{text} {_SIGNS[type(stmt.op)]} {as_kind(value, kind).text};")

    def _do_return(self, stmt: ast.Return) -> None:
        if stmt.value is None:
            self.lines.append("return;")
            return
        if isinstance(stmt.value, ast.Tuple):
            values = self.operands(stmt.value.elts)
            given = [one.id if isinstance(one, ast.Name) else "" for one in stmt.value.elts]
        else:
            one = self._direct(stmt.value)
            several = isinstance(one.kind, Several)
            values = self._call_for(one, stmt) if several else [one]
            given = [""] * len(values)
        self._result(stmt, [value.kind for value in values], given)
        if len(values) == 1:
            self.lines.append(f"return {values[0].text};")
            return
        for name, value in zip(self.result_names, values, strict=True):
            self.lines.append(f"*{name} = {value.text};")
        last = stmt is self.body[-1]
        if not last:
            self.lines.append("return;")

    def _result(self, stmt: ast.stmt, kinds: Sequence[Kind], given: Sequence[str]) -> None:
        if any(not isinstance(kind, Number) for kind in kinds):
            raise self.error(stmt, "return numbers; write arrays to an argument")
        if self.results and len(self.results) != len(kinds):
            raise self.error(stmt, "return as many values everywhere")
        old = self.results or (None,) * len(kinds)
        self.results = tuple(common_kind(a, b) for a, b in zip(old, kinds, strict=True))
        if not self.result_names:
            self.result_names = [
                f"{name}_out" if name else f"out_{i + 1}" for i, name in enumerate(given)
            ]

    def _do_if(self, stmt: ast.If) -> None:
        self._branch(stmt, "if")
        self.lines.append("}")

    def _branch(self, stmt: ast.If, word: str) -> None:
        before = len(self.lines)
        test = self.truth(stmt.test)
        if len(self.lines) > before and word != "if":
            raise self.error(stmt, "a call that changes states; give it a line before the `if`")
        self.lines.append(f"{word} ({test.text}) {{")
        self._inside(stmt.body, stmt.test.end_lineno or stmt.lineno)
        rest = stmt.orelse
        if len(rest) == 1 and isinstance(rest[0], ast.If):
            self._branch(rest[0], "} else if")
        elif rest:
            self.lines.append("} else {")
            self._inside(rest, stmt.body[-1].end_lineno or stmt.lineno)

    def _inside(self, body: Sequence[ast.stmt], after: int) -> None:
        self.lines += self.block(body, after)

    def _do_while(self, stmt: ast.While) -> None:
        if stmt.orelse:
            raise self.error(stmt, "a loop without `else`")
        test = self.apart(stmt.test, "in the condition of a loop")
        if test.kind != TRUTH:
            raise self.error(stmt, f"{ast.unparse(stmt.test)} is no comparison")
        self.lines.append(f"while ({test.text}) {{")
        self._inside(stmt.body, stmt.test.end_lineno or stmt.lineno)
        self.lines.append("}")

    def _do_for(self, stmt: ast.For) -> None:
        call = stmt.iter
        ranged = isinstance(call, ast.Call) and self.meaning.of(call.func) is range
        if not ranged or not isinstance(stmt.target, ast.Name) or stmt.orelse:
            raise self.error(stmt, "loops count: write `for i in range(n)`")
        assert isinstance(call, ast.Call)
        begin, end, step = self._range(call, _stored_names(stmt.body))
        name = self.fresh("round") if stmt.target.id == "_" else c_name(stmt.target.id)
        known = self.kinds.get(stmt.target.id)
        if stmt.target.id in self.counted or (known is not None and known != WHOLE):
            raise self.error(stmt, f"{stmt.target.id} is in use; take another name")
        self.kinds[stmt.target.id] = WHOLE
        least = begin.text if step > 0 else end.text.replace("-1", "0")
        if least.isdigit():
            self.counted.add(stmt.target.id)
        sign, change = ("<", f"+= {step}") if step > 0 else (">", f"-= {-step}")
        head = f"int32_t {name} = {begin.text}; {name} {sign} {end.text}; {name} {change}"
        self.lines.append(f"for ({head}) {{")
        self._inside(stmt.body, call.end_lineno or stmt.lineno)
        self.lines.append("}")
        self.counted.discard(stmt.target.id)

    def _range(self, call: ast.Call, stored: set[str]) -> tuple[Value, Value, int]:
        values = self.operands(call.args)
        if any(value.kind != WHOLE for value in values):
            raise self.error(call, f"{ast.unparse(call)}: whole numbers; write int(...)")
        begin = values[0] if len(values) > 1 else Value("0", WHOLE, fixed=True)
        end = values[min(1, len(values) - 1)]
        steps = [1, 1, 1, *(ast.literal_eval(one) for one in call.args[2:])]
        if not end.fixed or not _PLAIN_END.fullmatch(end.text) or end.text in stored:
            end = self.kept(Value(end.text, WHOLE), "end")
        return begin, end, int(steps[-1])


def _stored_names(body: Sequence[ast.stmt]) -> set[str]:
    """Return the names that statements set."""
    return {
        one.id
        for stmt in body
        for one in ast.walk(stmt)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }


def _changes(target: ast.expr, value: ast.expr) -> bool:
    """Return whether a value may be another one once the target is set."""
    if isinstance(target, ast.Name):
        return target.id in names(value)
    parts = list(ast.walk(value))
    if any(isinstance(one, ast.Call) for one in parts):
        return True
    if isinstance(target, ast.Attribute):
        return target.attr in {one.attr for one in parts if isinstance(one, ast.Attribute)}
    return any(isinstance(one, ast.Subscript) for one in parts)
