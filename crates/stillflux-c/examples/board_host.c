/* A host with a C library. */
#include "board.h"

#include <inttypes.h>
#include <stdio.h>

static char **arguments;
static unsigned count;
static FILE *files[8];

const char *board_argument(unsigned k)
{
  return k + 1 < count ? arguments[k + 1] : "";
}

int board_open(const char *path)
{
  for (int k = 0; k < 8; k++) {
    if (files[k] == NULL) {
      files[k] = fopen(path, "rb");
      return files[k] == NULL ? -1 : k;
    }
  }
  return -1;
}

size_t board_read(int file, void *to, size_t bytes)
{
  return fread(to, 1, bytes, files[file]);
}

void board_print(const char *text)
{
  fputs(text, stdout);
}

void board_number(uint32_t n)
{
  printf("%" PRIu32 "\n", n);
}

uint32_t board_clock(void)
{
  return 0;
}

int main(int argc, char **argv)
{
  arguments = argv;
  count = (unsigned)argc;
  return example();
}
