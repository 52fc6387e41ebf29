/* QEMU's mps2-an386 (Cortex-M4F) without a C library: vectors, start-up, semihosting, SysTick. A product has its
 * vendor's start-up code in place of this. */
#include "board.h"

#include <stdint.h>

extern uint32_t __data_load[], __data_start[], __data_end[], __bss_start[], __bss_end[], __stack[];

int main(void);
void reset(void);
void unexpected(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    __stack,    reset,      unexpected, unexpected, unexpected, unexpected, unexpected, 0,
    0,          0,          0,          unexpected, unexpected, 0,          unexpected, unexpected,
};

#define CPACR (*(volatile uint32_t *)0xE000ED88u)
#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)

static uint32_t semihosting(uint32_t call, const void *with)
{
  register uint32_t r0 __asm__("r0") = call;
  register const void *r1 __asm__("r1") = with;
  __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

static _Noreturn void leave(int success)
{
  /* ADP_Stopped_ApplicationExit, or ADP_Stopped_RunTimeErrorUnknown. */
  semihosting(0x18, (const void *)(success ? 0x20026u : 0x20023u));
  for (;;) {
  }
}

_Noreturn void unexpected(void)
{
  leave(0);
}

_Noreturn void reset(void)
{
  for (uint32_t *to = __data_start, *from = __data_load; to < __data_end;) {
    *to++ = *from++;
  }
  for (uint32_t *to = __bss_start; to < __bss_end;) {
    *to++ = 0;
  }
  /* The floating-point unit, before anything uses it. */
  CPACR |= 0xFu << 20;
  __asm__ volatile("dsb\n\tisb" ::: "memory");
  SYST_RVR = 0xFFFFFFu;
  SYST_CVR = 0;
  SYST_CSR = 5;
  leave(main() == 0);
}

static char line[512];

const char *board_argument(unsigned k)
{
  uint32_t request[2] = {(uint32_t)line, sizeof line};
  if (semihosting(0x15, request) != 0) {
    return "";
  }
  /* The first word is the name of the program. */
  char *at = line;
  for (unsigned word = 0;; word++) {
    while (*at == ' ') {
      at++;
    }
    char *begin = at;
    while (*at != ' ' && *at != 0) {
      at++;
    }
    char last = *at;
    if (word == k + 1) {
      *at = 0;
      return begin;
    }
    if (last == 0) {
      return "";
    }
  }
}

int board_open(const char *path)
{
  uint32_t length = 0;
  while (path[length] != 0) {
    length++;
  }
  uint32_t request[3] = {(uint32_t)path, 1, length};
  return (int)semihosting(0x01, request);
}

size_t board_read(int file, void *to, size_t bytes)
{
  uint32_t request[3] = {(uint32_t)file, (uint32_t)to, bytes};
  return bytes - semihosting(0x06, request);
}

void board_print(const char *text)
{
  static int out = -1;
  if (out < 0) {
    static const char console[] = ":tt";
    uint32_t request[3] = {(uint32_t)console, 4, 3};
    out = (int)semihosting(0x01, request);
  }
  uint32_t length = 0;
  while (text[length] != 0) {
    length++;
  }
  uint32_t request[3] = {(uint32_t)out, (uint32_t)text, length};
  semihosting(0x05, request);
}

void board_number(uint32_t n)
{
  char digits[12];
  unsigned at = sizeof digits;
  digits[--at] = 0;
  digits[--at] = '\n';
  do {
    digits[--at] = (char)('0' + n % 10);
    n /= 10;
  } while (n != 0);
  board_print(digits + at);
}

uint32_t board_clock(void)
{
  /* SysTick counts down, a tick every 40 instructions with -icount shift=0. */
  return 0xFFFFFFu - SYST_CVR;
}

int main(void)
{
  return example();
}
