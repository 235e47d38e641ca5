"""C functions that compiled code calls by their address, so that no Python runs between the steps of a simulation."""

import ctypes
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from llvmlite import binding, ir
from numba import typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

from imolo.contracts.engine import Array


class CFunction(NamedTuple):
    """A C function and what it is called with; whoever holds this keeps the arguments alive.

    Attributes:
        address: Where it is.
        arguments: Arrays, numbers and addresses.
    """

    address: int
    arguments: tuple[Any, ...]


class CompiledStep(NamedTuple):
    """How compiled code advances an engine by a step.

    Attributes:
        function: What does it.
        joint_torque: Where it takes the torques from, shape (J,).
        ball_force: Where it takes the ball's force from, shape (3,).
        ball_reaction: Where it leaves something that is not 0 if the ball touched, shape (3,).
        taken: To be told how many steps were taken since the last time, and whether the ball touched in the last one.
    """

    function: CFunction
    joint_torque: Array
    ball_force: Array
    ball_reaction: Array
    taken: Callable[[int, bool], None]


def c_function(function: Any, *arguments: Any) -> CFunction:
    """Return the C function in a function of Numba's for these arguments, which are always the same ones."""
    made = function.get_compile_result(types.void(*map(typeof, arguments)))
    return CFunction(made.library.get_pointer_to_function(made.fndesc.llvm_cfunc_wrapper_name), arguments)


def external(library: ctypes.CDLL, name: str, returned: Any, *arguments: Any) -> Any:
    """Return a C function for compiled code, where it ends the process if the library has none; see `has_all`."""
    if hasattr(library, name):
        binding.add_symbol(name, ctypes.cast(library[name], ctypes.c_void_p).value)
    return types.ExternalFunction(name, returned(*arguments))


def has_all(library: ctypes.CDLL, functions: Iterable[Any]) -> bool:
    """Return whether a library has all of these `external` functions."""
    return all(hasattr(library, function.symbol) for function in functions)


def answer_of(library: ctypes.CDLL, name: str, *ids: int) -> int:
    """Return the id or address that a C function returns."""
    function = library[name]
    function.restype = ctypes.c_size_t
    return int(function(*map(ctypes.c_size_t, ids)))


def definer(owner: Any, method: str) -> type[Any]:
    """Return the class that defines a method of an object."""
    return next(kind for kind in type(owner).__mro__ if method in vars(kind))


def twin(owner: Any, method: str, *given: Any) -> Any:
    """Return what `compiled_…` of the class that defines a method returns.

    None where there is no such method: a subclass that defines the method anew has no part in what it replaced.
    """
    compiled = vars(definer(owner, method)).get(f"compiled_{method}")
    return None if compiled is None else compiled(owner, *given)


@intrinsic
def call(_: Any, address: Any, arguments: Any) -> Any:
    """Call a C function that returns nothing, from compiled code."""

    def generate(context: Any, builder: Any, __: Any, given: Any) -> Any:
        values = cgutils.unpack_tuple(builder, given[1])
        kind = ir.FunctionType(ir.VoidType(), [value.type for value in values])
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), values)
        return context.get_dummy_value()

    return types.void(address, arguments), generate
