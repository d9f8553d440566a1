/* Lets user-mode-linux run on processors whose extended state is larger than it was built for.
 *
 * User-mode-linux keeps 2696 bytes of extended state (up to AVX-512 and PKRU) and writes them back with
 * PTRACE_SETREGSET. The host's kernel refuses any size but its own ("xstateregs_set" in
 * arch/x86/kernel/fpu/regset.c), which is larger where the processor has AMX, and the guest dies at its first
 * instruction. Preloaded, this asks the host for its size once and pads what is written: the guest's state
 * is a prefix of the host's, and the features behind it are marked as being in their initial state.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

#define FEATURES_OFFSET 512 /* XSTATE_BV in the header of the standard format */
#define KNOWN_FEATURES 0x2ffull /* x87, SSE, AVX, MPX, AVX-512, PKRU: all within the guest's bytes */

long ptrace(enum __ptrace_request request, ...)
{
    static long (*real)(enum __ptrace_request, ...);
    static uint8_t whole[65536] __attribute__((aligned(64)));
    static size_t host_size;
    va_list arguments;
    long pid;
    void *address;
    void *data;

    va_start(arguments, request);
    pid = va_arg(arguments, long);
    address = va_arg(arguments, void *);
    data = va_arg(arguments, void *);
    va_end(arguments);
    if (!real)
        real = (long (*)(enum __ptrace_request, ...))dlsym(RTLD_NEXT, "ptrace");
    if (request == PTRACE_SETREGSET && (uintptr_t)address == NT_X86_XSTATE) {
        struct iovec *given = data;
        struct iovec all = {whole, sizeof whole};
        uint64_t features;

        if (!host_size && real(PTRACE_GETREGSET, pid, address, &all) == 0)
            host_size = all.iov_len;
        if (given->iov_len < host_size && given->iov_len >= FEATURES_OFFSET + sizeof features) {
            memset(whole, 0, host_size);
            memcpy(whole, given->iov_base, given->iov_len);
            memcpy(&features, whole + FEATURES_OFFSET, sizeof features);
            features &= KNOWN_FEATURES;
            memcpy(whole + FEATURES_OFFSET, &features, sizeof features);
            all.iov_len = host_size;
            return real(request, pid, address, &all);
        }
    }
    return real(request, pid, address, data);
}
