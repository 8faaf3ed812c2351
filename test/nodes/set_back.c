// SPDX-License-Identifier: Apache-2.0
// Preloaded: as soon as the file that SET_BACK names is there, the system's clock is 5 years back.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
  static int (*real)(clockid_t, struct timespec *);
  if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  int result = real(clock, now);
  const char *file = getenv("SET_BACK");
  if (clock == CLOCK_REALTIME && file && access(file, F_OK) == 0) now->tv_sec -= 5L * 365 * 86400;
  return result;
}
