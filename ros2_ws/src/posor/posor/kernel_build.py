# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Build the library of the kernels: ``python -m posor.kernel_build FILE``.

The build needs numba and a C compiler, the library needs neither.

Numba compiles each kernel of PARTS with the types of ``kernel_examples`` and a wrapper that reads the arguments from
a table (see ``numerics.kernel_library``). LLVM links each part to one module, optimises it, and emits its machine code
for any processor of this architecture, without contraction to fused operations: the results are those of Python to the
last bit. Each part has a process, because the compilation takes minutes.
``--texts FOLDER`` keeps the assembler text, from which the C compiler alone makes the same library: a source release
has it in the folder ``kernels`` beside the package.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from posor.errors import SystemRefusal

JOINT_ENTRIES = {
    "estimation.estimate_scan": ("begin_scan_estimate", "estimate_scans", "solve_and_check", "write_lost"),
    "estimation.fault_effects": ("write_fault_effects",),
    "estimation.linearise": ("linearise_scan", "linearise_scans"),
    "estimation.solver": ("solve_start",),
    "messages.joint_transform": ("pack_rows",),
    "messages.message_stream": ("begin_message", "copy_transform", "end_message", "estimate_messages"),
    "messages.raw_scan": ("unpack_rows",),
    "model.reading_rows": ("_differentiate", "_evaluate", "_evaluate_poses", "prepare_rows", "turn_rows"),
    "model.spot_map": ("position_of_ratios", "ratios_of_positions"),
    "model.voltage": ("linearise_channels", "voltages_of_gaps"),
}
ARM_ENTRIES = {
    "chain.beam_vibration": ("follow_reading", "write_vibration"),
    "chain.encoder_filter": ("predict_endpoints", "use_transform", "use_transform_row"),
    "chain.fault_bounds": ("bound_endpoints",),
    "chain.forward_kinematics": ("estimate_endpoint_of_rows", "estimate_endpoints", "write_relative"),
    "messages.byte_kernels": ("copy_messages", "gather_rows", "index_messages", "write_records"),
    "numerics.summary_statistics": ("figures_of",),
}
PARTS = {"joint": JOINT_ENTRIES, "arm": ARM_ENTRIES}
"""Kernels that Python calls, by module; kernels that only kernels call are part of their code. For each part
``kernel_examples`` has a function that calls its kernels."""
PROCESSOR = "x86-64"  # the oldest of the architecture: a library may move to another machine
ASSEMBLER, C_TEXT = "{}_kernels.s", "posor_kernels.c"
C_SYMBOLS = ("NRT_", "Py", "_Py", "numba_")
"""Begins of the names of functions of numba and Python that the code mentions on ways that kernels do not take."""


IN_TURN_TEXT = """
typedef void (*kernel)(int64_t *, int64_t *);
void {name}(int64_t *calls, int64_t count)
{{
    for (int64_t n = 0; n < count; n++)
        ((kernel)calls[3 * n])((int64_t *)calls[3 * n + 1], (int64_t *)calls[3 * n + 2]);
}}
"""
"""C text of the function that runs kernels one after the other; each call is the addresses of code, table, results."""


class Entry(NamedTuple):
    """A kernel with the wrapper that the library exports."""

    name: str  # module and function
    symbol: str  # exported
    native_name: str  # of the wrapper in the LLVM module
    manifest: dict[str, Any]
    text: str = ""  # LLVM assembler of the wrapper and of all that it calls


class ArgumentReader:
    """Writes Python expressions that read the arguments of a kernel from the table ``t``."""

    def __init__(self) -> None:
        self.names: dict[str, Any] = {}  # that the expressions use
        self._word = 0

    def read(self, argument_type: Any) -> tuple[str, Any]:
        """Return the expression of an argument, and its type for the manifest."""
        types = import_module("numba").types
        if isinstance(argument_type, types.BaseTuple):
            elements = [self.read(element) for element in argument_type]
            expressions = ", ".join(expression for expression, _ in elements)
            make = ""
            if isinstance(argument_type, types.BaseNamedTuple):
                make = self._name(argument_type.instance_class)
            return f"{make}({expressions},)", [manifest for _, manifest in elements]
        word = self._word
        if isinstance(argument_type, types.Array):
            return self._array(argument_type, word)
        self._word += 1
        if isinstance(argument_type, types.Record):
            expression, dtype = self._memory(argument_type, word, "1, ")
            return f"{expression}[0]", {"dtype": dtype, "dimensions": None, "strided": False, "read_only": True}
        if isinstance(argument_type, types.Boolean):
            return f"t[{word}] != 0", "i"
        if isinstance(argument_type, types.Integer):
            return f"t[{word}]", "i"
        if argument_type == types.float64:
            return f"ft[{word}]", "f"
        message = f"kernels of the library take no {argument_type}"
        raise TypeError(message)

    def _array(self, array_type: Any, word: int) -> tuple[str, Any]:
        count, strided = array_type.ndim, array_type.layout != "C"
        self._word += 1 + (2 if strided else 1) * count
        shape, strides = ("".join(f"t[{word + first + n}], " for n in range(count)) for first in (1, 1 + count))
        expression, dtype = self._memory(array_type.dtype, word, "1, " * count if strided else shape)
        if strided:
            expression = f"as_strided({expression}, ({shape}), ({strides}))"
        properties = {"dimensions": count, "strided": strided, "read_only": not array_type.mutable}
        return expression, {"dtype": dtype, **properties}

    def _memory(self, element_type: Any, word: int, shape: str) -> tuple[str, str]:
        as_dtype = import_module("numba.np.numpy_support").as_dtype
        describe = import_module("posor.numerics.kernel_library").describe_dtype
        dtype = as_dtype(element_type)
        return f"carray(pointer(t[{word}]), ({shape}), {self._name(dtype)})", describe(dtype)

    def _name(self, value: Any) -> str:
        name = f"v{len(self.names)}"
        self.names[name] = value
        return name


def compile_entry(name: str, symbol: str, kernel: Any) -> Entry:
    """Compile the wrapper of a kernel."""
    numba, intrinsic = import_module("numba"), import_module("numba.extending").intrinsic
    types = numba.types

    @intrinsic  # type: ignore[untyped-decorator]  # of numba
    def pointer(_context: Any, word: Any) -> Any:
        def to_pointer(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

        return types.voidptr(word), to_pointer

    # Kernels may call this kernel with other numbers, as constants, which makes further signatures of the same memory.
    readers = {}
    for signature in kernel.signatures:
        reader = ArgumentReader()
        read = [reader.read(argument_type) for argument_type in map(types.unliteral, signature)]
        readers[json.dumps([each for _, each in read])] = signature, reader, read
    if len(readers) != 1:
        message = f"{name} is called with {len(readers)} kinds of arguments; expected one"
        raise ValueError(message)
    ((signature, reader, read),) = readers.values()
    call = f"kernel({', '.join(expression for expression, _ in read)})"
    result = kernel.overloads[signature].signature.return_type
    results = list(result) if isinstance(result, types.BaseTuple) else [] if result == types.none else [result]
    kinds = "".join("f" if isinstance(each, types.Float) else "b" if each == types.boolean else "i" for each in results)
    if len(results) > 1:
        stores = [f"out[{n}] = r[{n}]" for n in range(len(results))]
    else:
        stores = ["fout[0] = r" if kind == "f" else "out[0] = r" for kind in kinds]
    text = "\n    ".join([f"def {symbol}(t, ft, out, fout):", f"r = {call}", *stores, "return"])
    strides = {"as_strided": import_module("numpy").lib.stride_tricks.as_strided}
    scope = {"kernel": kernel, "carray": numba.carray, "pointer": pointer, **strides, **reader.names}
    exec(text, scope)  # noqa: S102  the text follows from the types of our own kernels
    words, floats = types.CPointer(types.int64), types.CPointer(types.float64)
    compiled = numba.cfunc(types.void(words, floats, words, floats), error_model="numpy")(scope[symbol])
    keeps_lock = not kernel.targetoptions.get("nogil", False)
    manifest = {"arguments": [each for _, each in read], "results": kinds, "keeps_lock": keeps_lock, "symbol": symbol}
    return Entry(name, symbol, compiled.native_name, manifest, compiled.inspect_llvm())


def compile_part(part: str) -> tuple[list[Entry], str]:
    """Compile the kernels of a part; return them without their LLVM texts, and the assembler text of all.

    Raises ValueError: Python calls a kernel with several types of arguments.
    """
    getattr(import_module("posor.kernel_examples"), f"use_{part}_kernels")()
    entries: list[Entry] = []
    for module, names in PARTS[part].items():
        for name in names:
            kernel, whole = getattr(import_module(f"posor.{module}"), name), f"posor.{module}.{name}"
            entries.append(compile_entry(whole, whole.replace(".", "_"), kernel))
    return [entry._replace(text="") for entry in entries], assemble(entries)


def assemble(entries: list[Entry]) -> str:
    """Return the assembler text of some entries."""
    llvm = import_module("llvmlite.binding")
    module = llvm.parse_assembly(entries[0].text)
    for entry in entries[1:]:
        module.link_in(llvm.parse_assembly(entry.text))
    exported = {entry.native_name for entry in entries}
    for function in module.functions:
        if not function.is_declaration and function.name not in exported:
            function.linkage = "internal"
    target = llvm.Target.from_triple(llvm.get_process_triple())
    machine = target.create_target_machine(cpu=PROCESSOR, features="", opt=3, reloc="pic", codemodel="small")
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    return str(machine.emit_assembly(module))


def c_source(entries: list[Entry], assembler: str, sources: str) -> str:
    """Return the C text of the exported functions, of the manifest, and of functions that are never called.

    ``sources``: hash of the sources of the kernels before they were compiled.
    """
    kernel_library = import_module("posor.numerics.kernel_library")
    kernels = {entry.name: entry.manifest for entry in entries}
    manifest = json.dumps({"sources": sources, "kernels": kernels})
    lines = ["#include <stdint.h>", "#include <stdlib.h>", IN_TURN_TEXT.format(name=kernel_library.IN_TURN)]
    mentioned = sorted({word for line in assembler.splitlines() for word in _functions_of(line)})
    lines += [f'__attribute__((visibility("hidden"))) void {name}(void) {{ abort(); }}' for name in mentioned]
    lines.append(f"const char {kernel_library.MANIFEST}[] = {json.dumps(manifest)};")
    for entry in entries:
        inner = f"inner_{entry.symbol}"
        lines.append(f'extern void {inner}(int64_t *, double *, int64_t *, double *) __asm__("{entry.native_name}");')
        body = f"{inner}(table, (double *)table, out, (double *)out);"
        lines.append(f"void {entry.symbol}(int64_t *table, int64_t *out) {{ {body} }}")
    return "\n".join(lines) + "\n"


def _functions_of(line: str) -> list[str]:
    """Return the functions of numba and Python that a line of assembler names."""
    words = line.replace("@", " ").replace(",", " ").replace("(", " ").split()
    return [word for word in words if word.startswith(C_SYMBOLS)]


def link(folder: Path, file: Path) -> None:
    """Make the library of the texts in a folder with the C compiler. Raises CalledProcessError: it failed."""
    compiler = os.environ.get("CC", "cc")
    texts = [folder / C_TEXT, *(folder / ASSEMBLER.format(part) for part in PARTS)]
    command = [compiler, "-O2", "-fPIC", "-shared", "-fno-strict-aliasing", "-s", "-o", file, *texts, "-lm"]
    subprocess.run([str(word) for word in command], check=True)


def is_current(file: Path) -> bool:
    """Return whether a library of the present sources exists."""
    if not file.is_file():
        return False
    try:
        import_module("posor.numerics.kernel_library").KernelLibrary(file)
    except SystemRefusal:
        return False
    return True


def write_texts(folder: Path) -> None:
    """Compile the kernels and write the texts of the library into a folder."""
    os.environ |= {"POSOR_KERNELS": "numba", "NUMBA_CPU_NAME": PROCESSOR, "NUMBA_CPU_FEATURES": ""}
    os.environ["NUMBA_OPT"] = "1"  # LLVM optimises all once more, after the kernels are linked
    folder.mkdir(parents=True, exist_ok=True)
    entries: list[Entry] = []
    assembler, sources = "", import_module("posor.numerics.kernel_library").hash_of_sources()
    with ProcessPoolExecutor(len(PARTS), get_context("fork")) as pool:  # forks: tests replace functions
        for part, (compiled, text) in zip(PARTS, pool.map(compile_part, PARTS), strict=True):
            (folder / ASSEMBLER.format(part)).write_text(text, encoding="utf-8")
            entries += compiled
            assembler += text
    (folder / C_TEXT).write_text(c_source(entries, assembler, sources), encoding="utf-8")


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(prog="kernel_build", description="Build the library of the kernels.")
    parser.add_argument("file", type=Path, help="library to write, unless it was made from the present sources")
    parser.add_argument("--texts", type=Path, metavar="FOLDER", help="folder that keeps assembler and C text")
    options = parser.parse_args()
    os.environ["POSOR_KERNELS"] = "python"
    if options.texts is None and is_current(options.file):
        return 0
    released = Path(__file__).parent.parent / "kernels"
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.texts or (released if (released / C_TEXT).is_file() else Path(scratch))
        if folder != released:
            write_texts(folder)
        link(folder, options.file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
