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
    .u_dc = 540.0, .f_s = 10e3, .u_th = 1.0, .r_d = 0.2, .dead_time = 2e-6, .f_clk = 170e6, .c_out = 1e-9,
    .half_periods = 2, .current_sensors = 3, .i_full = 17.7, .u_full = 810.0,
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
  const stillflux_converters adc = {STILLFLUX_RIGHT, 12, {2048, 2048, 2048}, {0, 0, 0}, STILLFLUX_RIGHT, 12};
  const uint16_t saturated[3] = {4095, 2048, 2048};
  stillflux_counts raw;
  stillflux_counts_from_raw(saturated, 2700, &adc, &raw);
  /* One reading is bridged, a second one is a fault. */
  stillflux_period(&drive, &raw, &speed, &command);
  stillflux_period(&drive, &raw, &speed, &command);
  char text[32];
  stillflux_fault_text(stillflux_fault(&drive), text, sizeof text);
  expect(stillflux_fault(&drive) == STILLFLUX_FAULT_MEASUREMENT, "a saturated channel is a fault");
  expect(command.gates_on == 0, "which blocks the bridge");
  expect(strcmp(text, "measurement") == 0, "the fault has a text");
  stillflux_fault_text(STILLFLUX_FAULT_MEASUREMENT, text, 5);
  expect(strcmp(text, "meas") == 0, "a text is cut to its buffer");
  stillflux_reset(&drive);
  expect(stillflux_status(&drive) == STILLFLUX_STOPPED, "a reset leaves the fault");

  const stillflux_converters offset = {
      STILLFLUX_LEFT_OFFSET, 12, {2048, 2048, 2048}, {2048, 2048, 2048}, STILLFLUX_LEFT, 12};
  const uint16_t above[3] = {100 << 3, 0, (uint16_t)(-(50 << 3))};
  stillflux_counts_from_raw(above, 4000 << 4, &offset, &raw);
  expect(raw.i_abc[0] == 100 << 4 && raw.i_abc[1] == 0 && raw.i_abc[2] == -(50 << 4) && raw.u_dc == 4000 << 3,
         "an offset by hardware is one bit lower");

  uint32_t stored[STILLFLUX_PAGE_WORDS];
  expect(stillflux_store(&drive, page, stored) == STILLFLUX_OK, "what the drive remembers is stored");
  expect(stillflux_open(&drive, sizeof drive, stored) == STILLFLUX_OK, "and taken back");
}

/* What is refused, to the user. */
static void report(const stillflux_error *e)
{
  fprintf(stderr, "%s = %g: %g to %g %s %s\n", e->field, e->value, e->min, e->max, e->unit, e->note);
}

/* A page with one setting changed: whether it differs from the one with the defaults; stops where it is refused. */
static int differs(const stillflux_settings *settings, const stillflux_memory *memory, const uint32_t *page)
{
  stillflux_error error;
  uint32_t changed[STILLFLUX_PAGE_WORDS];
  if (stillflux_page(&machine, &inverter, settings, memory, changed, &error) != STILLFLUX_OK) {
    report(&error);
    exit(1);
  }
  return memcmp(changed, page, sizeof changed) != 0;
}

static void settings_reach_the_page(const stillflux_settings *defaults, const stillflux_memory *memory,
                                    const uint32_t *page)
{
  expect(!differs(defaults, memory, page), "defaults give the same page");
  stillflux_settings s = *defaults;
  s.overmodulation = 1;
  expect(differs(&s, memory, page), "overmodulation");
  s = *defaults;
  s.field_weakening = 0;
  expect(differs(&s, memory, page), "field weakening");
  s = *defaults;
  s.acceleration = 100.0;
  expect(differs(&s, memory, page), "acceleration");
  s = *defaults;
  s.torque_limits[0] = -1.0;
  s.torque_limits[1] = 10.0;
  expect(differs(&s, memory, page), "limits of the torque");
  s = *defaults;
  s.speed_limits[1] = 100.0;
  expect(differs(&s, memory, page), "limits of the speed");
  s = *defaults;
  s.torque_limits[0] = s.torque_limits[1] = 0.0;
  expect(differs(&s, memory, page), "no torque");
  s = *defaults;
  s.machine_overload[0] = 5.0;
  s.machine_overload[1] = 600.0;
  expect(differs(&s, memory, page), "overload of the machine");
  s = *defaults;
  s.low_confidence = STILLFLUX_LOW_CONFIDENCE_LIMIT_TORQUE;
  expect(differs(&s, memory, page), "reaction to low confidence");
  s = *defaults;
  s.temperature = 1;
  s.winding_temperature = 20.0;
  expect(differs(&s, memory, page), "temperature");

  stillflux_error error;
  uint32_t refused[STILLFLUX_PAGE_WORDS];
  s = *defaults;
  s.discontinuous_above = 1.5;
  expect(stillflux_page(&machine, &inverter, &s, memory, refused, &error) == STILLFLUX_ERROR_PARAMETER &&
             strcmp(error.field, "discontinuous_above") == 0,
         "discontinuous modulation beyond its range is refused by name");
  s = *defaults;
  s.low_confidence = 9;
  expect(stillflux_page(&machine, &inverter, &s, memory, refused, &error) == STILLFLUX_ERROR_PARAMETER &&
             strcmp(error.field, "low_confidence") == 0,
         "a number without a meaning is refused by name");
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
             strcmp(error.field, "i_full") == 0 && strcmp(error.unit, "A") == 0 && error.min > 17.0,
         "a full scale that hides a saturated channel is refused by name");
  if (stillflux_page(&machine, &inverter, &settings, &memory, page, &error) != STILLFLUX_OK) {
    report(&error);
    return 1;
  }
  settings_reach_the_page(&settings, &memory, page);
  refusals(page);

  expect(argc > 1, "usage: page TO");
  FILE *to = fopen(argv[1], "wb");
  expect(to != NULL && fwrite(page, sizeof page, 1, to) == 1 && fclose(to) == 0, "the page cannot be written");
  return 0;
}
