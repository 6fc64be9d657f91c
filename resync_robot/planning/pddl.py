"""Predicates and operators to PDDL text and back. Names keep their case on the round trip."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Atom, Atoms, Object, Operator, Predicate, Type, Variable

Tree = str | list["Tree"]
NAME = re.compile(r"[A-Za-z][\w-]*")
REQUIREMENTS = ":strips :typing"
FOR_ALL = ":conditional-effects"
"""What PDDL calls a language with effects on every object."""


def domain_to_pddl(
    name: str, types: Iterable[Type], predicates: Iterable[Predicate], operators: Iterable[Operator]
) -> str:
    """A PDDL domain, sorted by name, so that equal models give equal text.

    Raises:
        PlanningError: a name that PDDL does not allow, or two that are the same for it.
    """
    types, predicates, operators = sorted(types), sorted(predicates), sorted(operators, key=lambda o: o.name)
    kinds: dict[str, list[Type] | list[Predicate] | list[Operator]] = {
        "type": types,
        "predicate": predicates,
        "operator": operators,
    }
    _check_names([(kind, named.name) for kind, those in kinds.items() for named in those])
    lines = [
        f"(define (domain {_checked(name)})",
        f"  (:requirements {' '.join([REQUIREMENTS, *([FOR_ALL] if any(o.delete_all for o in operators) else [])])})",
        f"  (:types {' '.join(t.name for t in types)})",
        "  (:predicates",
        *(f"    ({_typed(p.name, _variables(p))})" for p in predicates),
        "  )",
    ]
    for op in operators:
        lines += [f"  {line}" for line in operator_to_pddl(op).splitlines()]
    return "\n".join([*lines, ")", ""])


def operator_to_pddl(op: Operator) -> str:
    """One action of a domain."""
    effects = [_atom(a) for a in sorted(op.add)] + [f"(not {_atom(a)})" for a in sorted(op.delete)]
    effects += [_of_all(a, op.parameters) for a in sorted(op.delete_all)]
    return "\n".join(
        [
            f"(:action {op.name}",
            f"  :parameters ({_typed('', op.parameters).strip()})",
            # pyperplan crashes on an empty condition (), so a conjunction is always written.
            f"  :precondition {_conjunction(_atom(a) for a in sorted(op.preconditions))}",
            f"  :effect {_conjunction(effects)}",
            ")",
        ]
    )


def _of_all(atom: Atom, parameters: Iterable[Variable]) -> str:
    """A universally quantified delete effect."""
    free = [t for t in dict.fromkeys(atom.args) if isinstance(t, Variable) and t not in set(parameters)]
    return f"(forall ({_typed('', free).strip()}) (not {_atom(atom)}))"


def object_names(
    objects: Iterable[Object], types: Iterable[Type], predicates: Iterable[Predicate], operators: Iterable[Operator]
) -> dict[Object, str]:
    """What each object is called in PDDL: as it is here, or with a number behind where that name is taken.

    An object 'box' of the type 'box' becomes 'box0': many planners have one space of names for types, predicates,
    operators and objects, and none tells upper case from lower.
    """
    known = [*(t.name for t in types), *(p.name for p in predicates), *(o.name for o in operators)]
    taken = {name.lower() for name in known}
    names: dict[Object, str] = {}
    # Those that keep their name come first, so that no other is given it.
    for obj in sorted(objects, key=lambda o: (o.name.lower() in taken, o)):
        name, number = obj.name, 0
        while name.lower() in taken:
            name, number = f"{obj.name}{number}", number + 1
        taken.add(name.lower())
        names[obj] = name
    return names


def problem_to_pddl(name: str, domain: str, names: Mapping[Object, str], atoms: Atoms, goal: Atoms) -> str:
    """A PDDL problem of the objects that `names` names, as `object_names` does.

    Raises:
        PlanningError: a name that PDDL does not allow.
    """

    def conjuncts(of: Atoms) -> list[str]:
        return [
            f"({' '.join([a.predicate.name, *(names[o] if isinstance(o, Object) else o.name for o in a.args)])})"
            for a in sorted(of)
        ]

    listed = " ".join(f"{_checked(names[o])} - {o.type.name}" for o in sorted(names))
    return "\n".join(
        [
            f"(define (problem {_checked(name)})",
            *(f"  ; {new} is the object '{o.name}': that name is taken" for o, new in names.items() if new != o.name),
            f"  (:domain {_checked(domain)})",
            f"  (:objects {listed})",
            f"  (:init {' '.join(conjuncts(atoms))})",
            f"  (:goal {_conjunction(conjuncts(goal))})",
            ")",
            "",
        ]
    )


def domain_from_pddl(text: str, types: Mapping[str, Type]) -> tuple[tuple[Predicate, ...], tuple[Operator, ...]]:
    """Predicates and operators of a domain in the form `domain_to_pddl` writes (STRIPS with types).

    Args:
        types: type name -> type; PDDL knows no features, so the types come from the vocabulary.

    Raises:
        PlanningError: the text is not such a domain; the message says where.
    """
    tree = _read(text)
    if not isinstance(tree, list) or len(tree) < 2 or tree[0] != "define" or _head(tree[1]) != "domain":
        raise PlanningError("the text is no PDDL domain: it must start with (define (domain NAME)")
    predicates: dict[str, Predicate] = {}
    operators: list[Operator] = []
    for section in tree[2:]:
        head = _head(section)
        if head in (":requirements", ":types"):
            continue
        if head == ":predicates":
            for entry in section[1:]:
                variables = _read_variables(entry[1:], types, _head(entry))
                predicates[_head(entry)] = Predicate(_head(entry), tuple(v.type for v in variables))
        elif head == ":action":
            operators.append(_read_action(section, types, predicates))
        else:
            raise PlanningError(
                f"PDDL section '{head}' is not supported; allowed: :requirements, :types, :predicates, :action"
            )
    return tuple(sorted(predicates.values())), tuple(sorted(operators, key=lambda o: o.name))


def _read_action(section: Tree, types: Mapping[str, Type], predicates: Mapping[str, Predicate]) -> Operator:
    if len(section) < 2 or not isinstance(section[1], str):
        raise PlanningError("an :action in the PDDL text has no name")
    name, fields = section[1], section[2:]
    parts = dict(zip(fields[::2], fields[1::2], strict=False)) if all(isinstance(k, str) for k in fields[::2]) else {}
    if len(fields) % 2 or set(parts) - {":parameters", ":precondition", ":effect"} or ":parameters" not in parts:
        raise PlanningError(f"action {name} must have :parameters, :precondition and :effect, each with one list")
    parameters = _read_variables(parts[":parameters"], types, name)
    known = {v.name: v for v in parameters}
    needed, forbidden = _read_literals(parts.get(":precondition", []), known, predicates, name)
    effect, delete_all = _read_of_all(parts.get(":effect", []), types, known, predicates, name)
    add, delete = _read_literals(effect, known, predicates, name)
    if forbidden:
        raise PlanningError(f"action {name} has a negative precondition; use a predicate of its own for the negation")
    return Operator(name, parameters, needed, add, delete, delete_all)


def _read_of_all(
    tree: Tree,
    types: Mapping[str, Type],
    known: Mapping[str, Variable],
    predicates: Mapping[str, Predicate],
    where: str,
) -> tuple[Tree, Atoms]:
    """What is left of an effect without its (forall (?x - TYPE) (not ATOM)), and those atoms."""
    if not isinstance(tree, list) or not tree or tree[0] != "and":
        return tree, frozenset()
    rest: list[Tree] = []
    swept: set[Atom] = set()
    for literal in tree:
        if not (isinstance(literal, list) and literal and literal[0] == "forall"):
            rest.append(literal)
            continue
        if len(literal) != 3:
            raise PlanningError(f"action {where}: 'forall' takes variables and one effect")
        free = {v.name: v for v in _read_variables(literal[1], types, where)}
        added, removed = _read_literals(literal[2], {**known, **free}, predicates, where)
        if added:
            raise PlanningError(f"action {where}: only 'not' may stand behind 'forall'")
        swept |= removed
    return rest, frozenset(swept)


def _read_literals(
    tree: Tree, known: Mapping[str, Variable], predicates: Mapping[str, Predicate], where: str
) -> tuple[Atoms, Atoms]:
    """(positive, negative) atoms of a conjunction, a single literal or ()."""
    if not isinstance(tree, list):
        raise PlanningError(f"action {where}: expected a list instead of '{tree}'")
    literals = tree[1:] if tree and tree[0] == "and" else [tree] if tree else []
    found: tuple[set[Atom], set[Atom]] = (set(), set())
    for literal in literals:
        negative = _head(literal) == "not"
        if negative and len(literal) != 2:
            raise PlanningError(f"action {where}: 'not' takes one atom")
        atom = literal[1] if negative else literal
        predicate = _head(atom)
        if predicate not in predicates:
            raise PlanningError(
                f"action {where} uses the predicate '{predicate}', declared are: {', '.join(sorted(predicates))}"
            )
        args = []
        for a in atom[1:]:
            if not isinstance(a, str) or a not in known:
                raise PlanningError(f"action {where}: {a} is not among its parameters {', '.join(known)}")
            args.append(known[a])
        found[negative].add(predicates[predicate](*args))
    return frozenset(found[0]), frozenset(found[1])


def _read_variables(tree: Tree, types: Mapping[str, Type], where: str) -> tuple[Variable, ...]:
    """?a ?b - block ?r - robot -> variables."""
    result: list[Variable] = []
    waiting: list[str] = []
    tokens = list(tree) if isinstance(tree, list) else [tree]
    while tokens:
        token = tokens.pop(0)
        if not isinstance(token, str):
            raise PlanningError(f"{where}: expected a variable instead of a list")
        if token != "-":
            waiting.append(token)
            continue
        kind = tokens.pop(0) if tokens else "(none)"
        if not isinstance(kind, str) or kind not in types:
            raise PlanningError(f"{where}: unknown type '{kind}', known are: {', '.join(sorted(types))}")
        result += [Variable(v, types[kind]) for v in waiting]
        waiting = []
    if waiting:
        raise PlanningError(f"{where}: {' '.join(waiting)} has no type; write '{waiting[-1]} - TYPE'")
    return tuple(result)


def _read(text: str) -> Tree:
    """Nested lists of words. Written with a stack, so that deep nesting in a strange file cannot overflow."""
    stack: list[list[Tree]] = [[]]
    for number, line in enumerate(text.splitlines(), start=1):
        for token in re.findall(r"[()]|[^\s()]+", line.partition(";")[0]):
            if token == "(":
                stack.append([])
            elif token == ")":
                if len(stack) == 1:
                    raise PlanningError(f"PDDL line {number}: a ')' too many")
                done = stack.pop()
                stack[-1].append(done)
            else:
                stack[-1].append(token)
    if len(stack) > 1:
        raise PlanningError(f"PDDL text ends with {len(stack) - 1} list(s) still open: a ')' is missing")
    if len(stack[0]) != 1:
        raise PlanningError(f"PDDL text holds {len(stack[0])} expressions, expected one (define ...)")
    return stack[0][0]


def _head(tree: Tree) -> str:
    if not isinstance(tree, list) or not tree or not isinstance(tree[0], str):
        raise PlanningError(f"expected a list that starts with a word in the PDDL text, found {str(tree)[:60]}")
    return tree[0]


def _variables(predicate: Predicate) -> list[Variable]:
    return [Variable(f"?{t.name}{i}", t) for i, t in enumerate(predicate.types)]


def _typed(head: str, variables: Iterable[Variable]) -> str:
    return " ".join([head, *(f"{v.name} - {v.type.name}" for v in variables)])


def _atom(atom: Atom) -> str:
    return f"({' '.join([atom.predicate.name, *(a.name for a in atom.args)])})"


def _conjunction(literals: Iterable[str]) -> str:
    return f"({' '.join(['and', *literals])})"


def _checked(name: str) -> str:
    if not NAME.fullmatch(name):
        raise PlanningError(f"'{name}' cannot stand in PDDL: names are a letter, then letters, digits, '_' or '-'")
    return name


def _check_names(named: Iterable[tuple[str, str]]) -> None:
    """Refuse (kind, name) that PDDL cannot tell from an earlier one. Raises PlanningError."""
    found: dict[str, str] = {}
    for kind, name in named:
        words = f"{kind} '{name}'"
        other = found.get(_checked(name).lower())
        if other is not None:
            raise PlanningError(f"PDDL ignores case and kinds: {other} and {words} have one name", "rename one of them")
        found[name.lower()] = words
