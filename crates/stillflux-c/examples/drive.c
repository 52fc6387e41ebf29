/* The drive on a recorded loop: `drive PAGE FRAMES ANSWERS`.
 *
 * Reads a parameter page, hands the recorded readings and set points to the drive period by period, and compares what
 * comes back with what the same loop gave in Rust: every bit of compare values, gate signal and telemetry. A product
 * has the body of the loop in its control interrupt, with data registers in place of the frames and the timer's
 * preload registers in place of the comparison. */
#include "board.h"
#include "stillflux.h"

#include <stdint.h>

/* One period's input as recorded: four readings, kind and value of the set point. */
struct frame {
  stillflux_counts counts;
  stillflux_set_point set_point;
};

/* One period's output as recorded. */
struct answer {
  stillflux_command command;
  stillflux_telemetry telemetry;
};

static uint32_t page[STILLFLUX_PAGE_WORDS];
static stillflux_drive drive;

/* The empty call of the measurement in Rust: a word through memory that the optimiser does not see. */
__attribute__((noinline)) static void empty(uint32_t *state)
{
  volatile uint32_t held = *state;
  *state = held;
}

static uint32_t words_differ(const void *a, const void *b, size_t bytes)
{
  const uint32_t *x = a;
  const uint32_t *y = b;
  uint32_t n = 0;
  for (size_t k = 0; k < bytes / 4; k++) {
    n += x[k] != y[k];
  }
  return n;
}

int example(void)
{
  int page_file = board_open(board_argument(0));
  int frames = board_open(board_argument(1));
  int answers = board_open(board_argument(2));
  if (page_file < 0 || frames < 0 || answers < 0) {
    board_print("usage: drive PAGE FRAMES ANSWERS\n");
    return 1;
  }
  if (board_read(page_file, page, sizeof page) != sizeof page ||
      stillflux_open(&drive, sizeof drive, page) != STILLFLUX_OK) {
    board_print("parameter page is not valid\n");
    return 1;
  }

  static struct frame in[256];
  static struct answer want[256];
  uint32_t periods = 0, different = 0, timed = 0;
  uint64_t ticks = 0;
  for (;;) {
    size_t n = board_read(frames, in, sizeof in) / sizeof in[0];
    if (n == 0 || board_read(answers, want, n * sizeof want[0]) != n * sizeof want[0]) {
      break;
    }
    for (size_t k = 0; k < n; k++) {
      struct answer got;
      uint32_t running = stillflux_status(&drive) == STILLFLUX_RUNNING;
      /* What reading the clock and a call of an empty function cost is taken off again, as in Rust. */
      uint32_t nothing = 0;
      uint32_t before = board_clock();
      empty(&nothing);
      uint32_t start = board_clock();
      stillflux_period(&drive, &in[k].counts, &in[k].set_point, &got.command);
      uint32_t end = board_clock();
      if (running) {
        ticks += ((end - start) & 0xFFFFFFu) - ((start - before) & 0xFFFFFFu);
        timed++;
      }
      stillflux_telemetry_read(&drive, &got.telemetry);
      different += words_differ(&got, &want[k], sizeof got);
      periods++;
    }
  }

  board_print("periods ");
  board_number(periods);
  board_print("words different ");
  board_number(different);
  if (ticks != 0) {
    board_print("hundredths of an instruction a period ");
    board_number((uint32_t)(ticks * BOARD_TICK * 100u / timed));
  }
  return periods == 0 || different != 0;
}
