// Parses numbers from text, with the same number of words in each line; every character is checked.
#include "common.h"

#include <array>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <string>
#include <string_view>
#include <tuple>

#ifdef __APPLE__
#include <xlocale.h>
#else
#include <locale.h>
#endif

namespace torchjoint {
namespace {

// The C++ library of manylinux_2_28 wheels does not have std::from_chars for doubles yet.
double slow_value(const char* begin, const char* end) {
  const std::string word(begin, end);
#ifdef _WIN32
  static const _locale_t plain = _create_locale(LC_ALL, "C");
  return _strtod_l(word.c_str(), nullptr, plain);
#else
  static const locale_t plain = newlocale(LC_ALL_MASK, "C", nullptr);
  return strtod_l(word.c_str(), nullptr, plain);
#endif
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

constexpr std::array<uint64_t, 20> kPowers = [] {
  std::array<uint64_t, 20> powers{1};
  for (size_t i = 1; i < powers.size(); ++i) powers[i] = powers[i - 1] * 10;
  return powers;
}();

// digits / 10^places, correctly rounded, for digits > 0 and places < 20.
double divided(uint64_t digits, int places) {
  if (digits <= uint64_t{1} << 53) {  // both are doubles (10^19, too), and a division is correctly rounded
    return static_cast<double>(digits) / static_cast<double>(kPowers[places]);
  }
  // A quotient of 63 or 64 bits. A remainder sets its last bit, which is far below the bits of a double.
  const uint64_t divisor = kPowers[places];
  const int left = std::countl_zero(digits), below = std::countl_zero(divisor);
  __extension__ using Wide = unsigned __int128;
  const Wide dividend = static_cast<Wide>(digits << left) << 63;
  const uint64_t quotient = static_cast<uint64_t>(dividend / (divisor << below));
  const bool exact = static_cast<Wide>(quotient) * (divisor << below) == dividend;
  return std::ldexp(static_cast<double>(quotient | !exact), below - left - 63);
}

// The end of the word `name` at the start of `text`, in small letters or capitals; nullptr for another word.
const char* skip_name(const char* text, const char* end, std::string_view name) {
  if (end - text < static_cast<int64_t>(name.size())) return nullptr;
  for (size_t i = 0; i < name.size(); ++i) {
    if ((text[i] | 32) != name[i]) return nullptr;
  }
  return text + name.size();
}

// "inf", "infinity" or "nan" at the start of `text`.
const char* parse_name(const char* text, const char* end, double& value) {
  value = std::numeric_limits<double>::infinity();
  if (const char* const after = skip_name(text, end, "infinity")) return after;
  if (const char* const after = skip_name(text, end, "inf")) return after;
  value = std::numeric_limits<double>::quiet_NaN();
  return skip_name(text, end, "nan");
}

// The digits, decimal point and exponent that were read so far.
struct Decimal {
  uint64_t digits = 0;
  int count = 0;  // number of significant digits
  int64_t places = 0;  // digits after the point, less the exponent
  bool is_any = false;  // whether any digit was read

  const char* read_digits(const char* text, const char* end, bool after_point) {
    for (; text != end && is_digit(*text); ++text) {
      is_any = true;
      count += count > 0 || *text != '0';
      if (count <= 19) digits = digits * 10 + (*text - '0');
      places += after_point;
    }
    return text;
  }

  // nullptr if "e" is not followed by a number.
  const char* read_exponent(const char* text, const char* end) {
    const bool negative = text != end && *text == '-';
    if (text != end && (*text == '-' || *text == '+')) ++text;
    if (text == end || !is_digit(*text)) return nullptr;
    int64_t exponent = 0;
    for (; text != end && is_digit(*text); ++text) exponent = std::min<int64_t>(exponent * 10 + (*text - '0'), 1 << 20);
    places += negative ? exponent : -exponent;
    return text;
  }
};

// Parses the number at the start of `text`; returns where it ends, or nullptr if there is none.
const char* parse_number(const char* text, const char* end, double& value) {
  const bool negative = *text == '-';
  if (*text == '-' || *text == '+') ++text;
  Decimal decimal;
  const char* place = decimal.read_digits(text, end, false);
  if (place != end && *place == '.') place = decimal.read_digits(place + 1, end, true);
  if (!decimal.is_any) {
    place = parse_name(text, end, value);
  } else {
    if (place != end && (*place | 32) == 'e') place = decimal.read_exponent(place + 1, end);
    if (place == nullptr) return nullptr;
    if (decimal.count == 0) {
      value = 0;
    } else if (decimal.count <= 19 && decimal.places >= 0 && decimal.places < 20) {
      value = divided(decimal.digits, static_cast<int>(decimal.places));
    } else {
      value = slow_value(text, place);
    }
  }
  if (negative) value = -value;
  return place;
}

// A line feed is not a blank, because it ends a row.
const char* skip_blanks(const char* text, const char* end) {
  while (text != end && *text != '\n' && is_space(*text)) ++text;
  return text;
}

const char* word_end(const char* text, const char* end) {
  while (text != end && !is_space(*text)) ++text;
  return text;
}

class Parser {
 public:
  Parser(const char* text, int64_t size, int64_t num_rows, int64_t num_columns)
      : begin_(text), end_(text + size), num_rows_(num_rows), num_columns_(num_columns) {}

  // Writes the numbers of each column; returns the position after the last row.
  int64_t parse(double* values) const {
    const char* place = begin_;
    for (int64_t row = 0; row < num_rows_; ++row) {
      const char* const line = place;
      for (int64_t column = 0; column < num_columns_; ++column) {
        place = skip_blanks(place, end_);
        if (place == end_ || *place == '\n') fail_count(line, row);
        const char* const word = place;
        place = parse_number(word, end_, values[column * num_rows_ + row]);
        if (place == nullptr || (place != end_ && !is_space(*place))) fail_word(word, row);
      }
      place = skip_blanks(place, end_);
      if (place != end_ && *place != '\n') fail_count(line, row);
      if (place != end_) ++place;
    }
    return place - begin_;
  }

 private:
  [[noreturn]] void fail_count(const char* line, int64_t row) const {
    int64_t words = 0;
    for (const char* place = skip_blanks(line, end_); place != end_ && *place != '\n'; ++words) {
      place = skip_blanks(word_end(place, end_), end_);
    }
    fail("text: expected ", num_columns_, " numbers in row ", row, ", got ", words, " words");
  }

  [[noreturn]] void fail_word(const char* word, int64_t row) const {
    std::string shown(word, std::min(word_end(word, end_), word + 40));
    for (char& c : shown) c = c > ' ' && c <= '~' ? c : '?';
    fail("text: a word is no number: expected ", num_columns_, " numbers in row ", row, ", got '", shown, "' at byte ",
         word - begin_);
  }

  const char* begin_;
  const char* end_;
  int64_t num_rows_, num_columns_;
};

std::tuple<Tensor, Tensor> parse_numbers(const Tensor& text, int64_t num_rows, int64_t num_columns) {
  const Tensor bytes = checked_array(text, ScalarType::Byte, {-1}, "text");
  const int64_t size = bytes.size(0);
  check(num_rows >= 0, "num_rows: expected a number >= 0, got ", num_rows);
  check(num_columns > 0, "num_columns: expected a number > 0, got ", num_columns);
  // Each number has at least one character: so a file that declares a wrong size cannot cause a large allocation.
  check(num_rows == 0 || num_columns <= size / num_rows, "text: expected ", num_rows, " rows of ", num_columns,
        " numbers, got ", size, " bytes");
  Tensor values = torch::stable::new_empty(bytes, {num_columns, num_rows}, ScalarType::Double);
  const Parser parser(reinterpret_cast<const char*>(bytes.const_data_ptr<uint8_t>()), size, num_rows, num_columns);
  const int64_t end = parser.parse(values.mutable_data_ptr<double>());
  return {values, to_tensor(std::vector<int64_t>{end}, ScalarType::Long, bytes)};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("parse_numbers(Tensor text, int num_rows, int num_columns) -> (Tensor values, Tensor end)");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl("parse_numbers", TORCH_BOX(&parse_numbers)); }

}  // namespace torchjoint
