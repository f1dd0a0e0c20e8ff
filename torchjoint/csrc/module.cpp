// An empty Python module: importing torchjoint._C loads the library, whose static initialisers register the operators.
#include <Python.h>

// libstdc++ reads this variable of glibc >= 2.32 to avoid atomic operations in programs with one thread. We define our own
// copy, which means several threads, so that the binary also loads with older glibc (manylinux_2_28, like torch).
#ifdef __linux__
extern "C" __attribute__((visibility("hidden"))) char __libc_single_threaded;
char __libc_single_threaded = 0;
#endif

PyMODINIT_FUNC PyInit__C(void) {
  static struct PyModuleDef module = {
      PyModuleDef_HEAD_INIT, "_C", nullptr, -1, nullptr, nullptr, nullptr, nullptr, nullptr};
  return PyModule_Create(&module);
}
