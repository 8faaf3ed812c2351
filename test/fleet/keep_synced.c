/* Preloaded into a process: keeps how long each file was that it has synced, in FILE.synced. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

int fsync(int file)
{
  static int (*real)(int);
  struct stat known;
  char link[64], name[4096];
  ssize_t length;
  int result, kept;

  if (!real) real = (int (*)(int))dlsym(RTLD_NEXT, "fsync");
  result = real(file);
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  length = readlink(link, name, sizeof name - 8);
  if (result || length < 8 || strncmp(name + length - 8, ".journal", 8)) return result;
  strcpy(name + length, ".synced");
  fstat(file, &known);
  kept = open(name, O_WRONLY | O_CREAT, 0644);
  /* One write of a few bytes is never torn by SIGKILL. */
  dprintf(kept, "%020lld\n", (long long)known.st_size);
  close(kept);
  return result;
}
