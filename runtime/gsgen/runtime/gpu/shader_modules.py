"""Compiles WGSL shaders, without the counters that wgpu adds to loops."""

__all__ = ["create_shader_module"]

from typing import Any, Final

from gsgen.runtime.gpu.handles import RawDevice, ShaderModule

_CREATE: Final = "wgpuDeviceCreateShaderModuleTrusted"
_BOUNDED_LOOPS: Final = 2  # a bit of WGPUShaderRuntimeChecks in wgpu.h
_CHECKS: Final = 0x1F ^ _BOUNDED_LOOPS


def create_shader_module(raw: RawDevice, label: str, code: str) -> ShaderModule:
    """Compile the WGSL text of a shader whose loops all end.

    wgpu ends every loop after 2⁶⁴ turns, by two words that each turn decrements and tests. Kernels
    loop over ranges, so that they need no such test. All other checks of wgpu stay. Where its
    native library cannot leave out a check, or is not used, shaders are compiled with all of them.
    """
    native = getattr(raw, "_internal", None)
    create = None if native is None else _native_function()
    if create is None:
        return raw.create_shader_module(label=label, code=code)
    from wgpu.backends.wgpu_native import GPUShaderModule, ffi, lib

    name, text = (ffi.new("char[]", string.encode()) for string in (label, code))
    shader = ffi.new("WGPUShaderSourceWGSL *")
    shader.chain.sType = lib.WGPUSType_ShaderSourceWGSL
    shader.code.data, shader.code.length = text, len(text) - 1
    descriptor = ffi.new("WGPUShaderModuleDescriptor *")
    descriptor.nextInChain = ffi.cast("WGPUChainedStruct *", shader)
    descriptor.label.data, descriptor.label.length = name, len(name) - 1
    return GPUShaderModule(label, create(native, descriptor, _CHECKS), raw)


def _native_function() -> Any:
    """Return wgpu's function for shaders with chosen checks, which raises errors; None without."""
    from wgpu.backends.wgpu_native import _api

    return getattr(_api.libf, _CREATE, None)
