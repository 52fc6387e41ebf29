/* What an example needs of the machine it runs on: files, a line of text, a clock. board_host.c and board_mps2.c. */
#ifndef BOARD_H
#define BOARD_H

#include <stddef.h>
#include <stdint.h>

/* Word `k` of the command line after the name of the program; empty where there is none. */
const char *board_argument(unsigned k);
/* Opens a file for reading; negative: cannot be opened. */
int board_open(const char *path);
/* Reads up to `bytes`; returns how many there were. */
size_t board_read(int file, void *to, size_t bytes);
/* Prints a text, and a number with a line end. */
void board_print(const char *text);
void board_number(uint32_t n);
/* Counts up with the instructions executed, in steps of BOARD_TICK of them; 24 bits. Stands still on a host. */
#define BOARD_TICK 40u
uint32_t board_clock(void);

/* The example; 0: success. */
int example(void);

#endif
