/* A parameter page from SI values, on a host: `page TO` writes the page of the 2.2-kW machine on its inverter.
 *
 * A product's commissioning tool does this once for each machine and stores the page in flash; the target reads it with
 * stillflux_open() without any conversion. */
#include "stillflux.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const stillflux_machine machine = {
    .R_s = 3.7, .R_R = 2.1, .L_sigma = 0.021, .L_M = 0.224, .n_p = 2, .J = 0.015,
    .U_N = 400.0, .I_N = 5.0, .f_N = 50.0, .T_N = 14.6, .L_u = 0.34, .a = 0.84, .S = 7.0,
};
static const stillflux_inverter inverter = {
    .u_dc = 540.0, .f_s = 10e3, .u_th = 1.0, .r_d = 0.2, .dead_time = 2e-6, .f_clk = 170e6, .c_out = 1e-9, .half_periods = 2, .current_sensors = 3,
    .i_full = 17.7, .u_full = 810.0,
};

static void expect(int condition, const char *what)
{
  if (!condition) {
    fprintf(stderr, "%s\n", what);
    exit(1);
  }
}

/* What is refused, and how. */
static void refusals(const uint32_t *page)
{
  static stillflux_drive drive;
  stillflux_command command = {{1, 1, 1}, 1};
  const stillflux_counts counts = {{0, 0, 0}, 20000};
  const stillflux_set_point speed = {STILLFLUX_SPEED, 10.0f};
  stillflux_period(&drive, &counts, &speed, &command);
  expect(command.gates_on == 0, "a state without a drive blocks the bridge");

  uint32_t torn[STILLFLUX_PAGE_WORDS];
  memcpy(torn, page, sizeof torn);
  torn[20] ^= 1;
  expect(stillflux_open(&drive, sizeof drive, torn) == STILLFLUX_ERROR_PAGE, "a torn page is refused");
  expect(stillflux_open(&drive, sizeof drive - 8, page) == STILLFLUX_ERROR_SIZE, "another size is refused");
  expect(stillflux_store(&drive, page, torn) == STILLFLUX_ERROR_CLOSED, "nothing to store without a drive");
  expect(stillflux_open(&drive, sizeof drive, page) == STILLFLUX_OK, "a whole page is taken");
  expect(stillflux_timer_full(&drive) == 8500, "170 MHz at 10 kHz");

  /* A saturated channel: the top code of a 12-bit converter. */
  const stillflux_converters adc = {STILLFLUX_RIGHT, 12, {2048, 2048, 2048}, STILLFLUX_RIGHT, 12};
  const uint16_t saturated[3] = {4095, 2048, 2048};
  stillflux_counts raw;
  stillflux_counts_from_raw(saturated, 2700, &adc, &raw);
  /* One reading is bridged, a second one is a fault. */
  stillflux_period(&drive, &raw, &speed, &command);
  stillflux_period(&drive, &raw, &speed, &command);
  char text[32];
  stillflux_fault_text(stillflux_fault(&drive), text, sizeof text);
  expect(stillflux_fault(&drive) == STILLFLUX_FAULT_MEASUREMENT && command.gates_on == 0, "a saturated channel is a fault");
  expect(strcmp(text, "measurement") == 0, "the fault has a text");
  stillflux_fault_text(STILLFLUX_FAULT_MEASUREMENT, text, 5);
  expect(strcmp(text, "meas") == 0, "a text is cut to its buffer");
  stillflux_reset(&drive);
  expect(stillflux_status(&drive) == STILLFLUX_STOPPED, "a reset leaves the fault");

  uint32_t stored[STILLFLUX_PAGE_WORDS];
  expect(stillflux_store(&drive, page, stored) == STILLFLUX_OK, "what the drive remembers is stored");
  expect(stillflux_open(&drive, sizeof drive, stored) == STILLFLUX_OK, "and taken back");
}

int main(int argc, char **argv)
{
  stillflux_settings settings;
  stillflux_memory memory;
  stillflux_error error;
  uint32_t page[STILLFLUX_PAGE_WORDS];
  stillflux_defaults(&machine, &inverter, &settings);
  stillflux_memory_of(&machine, &inverter, &memory);
  /* From an earlier run. */
  memory.u_off[0] = 0.05;
  memory.u_off[1] = -0.03;

  stillflux_inverter small = inverter;
  small.i_full = 10.0;
  expect(stillflux_page(&machine, &small, &settings, &memory, page, &error) == STILLFLUX_ERROR_PARAMETER &&
             strcmp(error.field, "i_full") == 0 && error.min > 17.0,
         "a full scale that hides a saturated channel is refused by name");
  if (stillflux_page(&machine, &inverter, &settings, &memory, page, &error) != STILLFLUX_OK) {
    fprintf(stderr, "%s = %g: %g to %g\n", error.field, error.value, error.min, error.max);
    return 1;
  }
  refusals(page);

  FILE *to = argc > 1 ? fopen(argv[1], "wb") : NULL;
  expect(to != NULL && fwrite(page, sizeof page, 1, to) == 1 && fclose(to) == 0, "usage: page TO");
  return 0;
}
